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

"""How Sphinx builds the documentation: `make docs`."""

from pathlib import Path
import xml.etree.ElementTree as ElementTree

PACKAGE = ElementTree.parse(Path(__file__).resolve().parent.parent / 'package.xml').getroot()

project = PACKAGE.findtext('name')
author = PACKAGE.findtext('maintainer')
release = PACKAGE.findtext('version')
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.mathjax', 'sphinx.ext.napoleon']
html_theme = 'sphinx_rtd_theme'
exclude_patterns = ['_build']
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
autodoc_typehints = 'none'  # the docstrings say it with shapes and units
