"""What all pictures share: colours, words, the style of axes, and the way to a file."""

import io
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

BASE, EE, DESIRED, FAILURE, GOAL = "#1f5fa8", "#17906b", "#3a3f47", "#d62f3c", "#e69f00"
"""The colours of base, achieved EE, desired EE, kinematic failure and goal in every picture."""

BODY, ARM = "#c3c9d2", "#5b93cf"
"""Of a robot's solids: what its arm does not move, and the arm with its hand."""

INK, FAINT = "#2b2f36", "#8a919c"

# Any: matplotlib's types know each key by name, and no dict of strings is one of those.
STYLE: Any = {
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
    """Return how often IK failed, in words."""
    return {0: "no failure", 1: "1 failure"}.get(count, f"{count} failures")


def png(figure: Figure, dpi: int = 100) -> bytes:
    """Return a figure as a PNG file."""
    file = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
