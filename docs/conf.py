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
