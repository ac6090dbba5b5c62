"""Sphinx configuration of the site: ``python -m sphinx -W -b html docs docs/_build/html``."""

import sys
from pathlib import Path

import warpcontact

# Extensions in this folder.
sys.path.insert(0, str(Path(__file__).parent))

project = "warpcontact"
author = "the authors of warpcontact"
project_copyright = author
release = version = warpcontact.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.doctest",
    "outside",  # pages made from files elsewhere in the repository
    "contents",  # the tree of pages
    "gallery",  # pages of the examples
    "reference",  # formulas, catalogues and argument types in addition to docstrings
]
exclude_patterns = ["_build"]
# Anchors of headings, as on a git host.
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True  # properties among attributes are described once

doctest_global_setup = """
import numpy as np
import warp as wp

import warpcontact as wc

wp.config.log_level = wp.LOG_ERROR
"""

html_theme = "furo"
html_title = f"warpcontact {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "monokai"
