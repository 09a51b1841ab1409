"""Sphinx configuration of the documentation site: `make docs`."""

from pygments.lexers.special import TextLexer
from sphinx.highlighting import lexers

from kinfeas import __version__

project = "kinfeas"
author = "the kinfeas authors"
copyright = author
release = version = __version__
language = "en"

extensions = ["myst_parser", "sphinx_copybutton"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
# Links to other files, such as those of examples/, become downloads.
exclude_patterns = ["_build"]

smartquotes = False

html_theme = "furo"
html_title = "kinfeas"
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False

lexers["csv"] = TextLexer()
