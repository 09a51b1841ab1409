"""The commands as functions: `kinfeas.train`, `evaluate`, `deploy` and so on.

Each module defines the function of its name, and is imported at its first use. The functions raise
KinfeasError for bad input. They print nothing; callbacks such as `on_progress` report progress.
"""

from collections.abc import Callable
from pathlib import Path

DEFAULT_ROBOT = "pr2"

Name = str | Path
"""A name or the path of a file."""

OnProgress = Callable[[str, float], None]
"""Called with a description of the current work and the fraction of it that is done, 0-1."""


def counter(on_progress: OnProgress | None, text: str, total: float = 1.0) -> Callable[..., None]:
    """Return a function that adds an amount of work and reports the fraction of `total` done.

    Its second argument, `note`, is appended to the text.
    """
    done = 0.0

    def add(amount: float = 1.0, note: str = "") -> None:
        nonlocal done
        done += amount
        if on_progress is not None:
            on_progress(text + note, done / max(total, 1e-9))

    add(0.0)
    return add
