"""Colours, the style of axes, and PNG files of figures."""

import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BASE, EE, DESIRED, FAILURE, GOAL = "#1f5fa8", "#17906b", "#3a3f47", "#d62f3c", "#e69f00"
"""Colours of base, achieved EE, desired EE, IK failure and goal."""

BODY, ARM = "#c3c9d2", "#5b93cf"
"""Colours of a robot's body, and of its arm with the hand."""

INK, FAINT = "#2b2f36", "#8a919c"

TITLES = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}
"""Names of the shipped robots in tables and pictures."""

STYLE: Any = {  # Any: matplotlib types each key by name
    "font.size": 10.0,
    "font.family": "DejaVu Sans",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b8bec7",
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.facecolor": "white",
}


def failures_text(count: int) -> str:
    """Return a number of IK failures as a text."""
    return {0: "no failure", 1: "1 failure"}.get(count, f"{count} failures")


def png(figure: "Figure", dpi: int = 100) -> bytes:
    """Return a figure as a PNG file."""
    from matplotlib import rc_context

    file = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
