# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Settings of Sphinx, which builds the documentation: `make docs`."""

from pathlib import Path
import re
import xml.etree.ElementTree as ElementTree

from docutils.nodes import entry, SkipNode
from latex2mathml.converter import convert

PACKAGE = ElementTree.parse(Path(__file__).resolve().parent.parent / 'package.xml').getroot()

project = PACKAGE.findtext('name')
author = PACKAGE.findtext('maintainer')
release = PACKAGE.findtext('version')
project_copyright = f'2026 {author}. {PACKAGE.findtext("license")}'
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'sphinx_rtd_theme'
html_static_path = ['_static']
html_css_files = ['layout.css']
html_math_renderer = 'mathml'
exclude_patterns = ['_build']
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
smartquotes = False  # options begin with two hyphens, not with a dash
autodoc_typehints = 'none'  # the docstrings state types with shapes and units


def write_inline(translator, node):
    """Write a formula in a line as MathML, which browsers draw without scripts or a network."""
    translator.body.append(convert(node.astext()))
    raise SkipNode


def write_block(translator, node):
    """Write a formula on a line of its own as MathML."""
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise SkipNode


def mark_numbers(app, page):
    """Give the cells that hold a number a class, so that 1e-9 is not broken at the hyphen."""
    for cell in page.findall(entry):
        if re.fullmatch(r'[-+.\de]+', cell.astext()):
            cell['classes'].append('number')


def setup(app):
    """Register the functions above."""
    app.connect('doctree-read', mark_numbers)
    app.add_html_math_renderer('mathml', (write_inline, None), (write_block, None))
