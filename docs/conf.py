"""Sphinx configuration of the documentation site: `make docs`."""

import re
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.highlighting import lexers

sys.path.insert(0, str(Path(__file__).parent))

from kinfeas import __version__

project = "kinfeas"
author = "the kinfeas authors"
copyright = author
release = version = __version__
language = "en"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "command_reference",
]
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

# Docstrings quote code with single backticks.
default_role = "code"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

# Signatures show the names of type aliases.
_NUMBERS = "~numpy.ndarray[tuple[~typing.Any, ...], ~numpy.dtype[~numpy.{}]]"
_ALIASES = {_NUMBERS.format("float64"): "Array"}
_ALIASES |= {_NUMBERS.format(kind): f"NDArray[{kind}]" for kind in ("intp", "bool", "uint64")}
_ARRAY_LIKE = re.compile(
    r"~numpy\._typing\.\S*_Buffer \| .*?~numpy\._typing\.\S*\[complex \| bytes \| str\]"
)
# Bounds of numbers are in the documentation of the fields.
_BOUNDED = re.compile(r"~typing\.Annotated\[([^,\[\]]+), ~?[\w.]*Interval\([^)]*\)\]")


def _name_aliases(
    app: Sphinx, what: str, name: str, thing: object, options: object, *signature: str | None
) -> tuple[str | None, ...]:
    """Return a signature with the names of type aliases."""
    if getattr(thing, "_is_protocol", False):
        return "", None
    return tuple(_shortened(part) if part else part for part in signature)


def _shortened(text: str) -> str:
    for long, short in _ALIASES.items():
        text = text.replace(long, short)
    return _BOUNDED.sub(r"\1", _ARRAY_LIKE.sub("ArrayLike", text))


def setup(app: Sphinx) -> None:
    """Register the shortening of signatures."""
    app.connect("autodoc-process-signature", _name_aliases)
