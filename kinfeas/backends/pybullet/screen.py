"""Whether there is a screen on which PyBullet can open its window."""

import os
import subprocess
import sys

from kinfeas.core.errors import KinfeasError

_TRIAL = "import os, pybullet; os._exit(pybullet.connect(pybullet.GUI) < 0)"
_PATIENCE = 30.0  # s


def check_screen() -> None:
    """Check that a window can be opened.

    PyBullet ends the process where there is no screen, or one that it cannot draw on, so that this
    is tried in a process of its own.

    Raises:
        KinfeasError: If it cannot.
    """
    if sys.platform != "linux":
        return
    display = os.environ.get("DISPLAY")
    if not display:
        raise KinfeasError("a window needs a screen, and DISPLAY names none")
    if not _opens():
        raise KinfeasError(
            f"a window needs a screen, and PyBullet cannot open one on DISPLAY {display!r}"
        )


def _opens() -> bool:
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL], capture_output=True, timeout=_PATIENCE, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return trial.returncode == 0
