"""Where numba keeps what it has compiled."""

import os
import stat
import tempfile
from pathlib import Path

import numba

from kinfeas.errors import KinfeasError


def settle() -> None:
    """Let numba cache beside other temporary files where it can nowhere else.

    It takes the folder of the sources or the user's own cache, and raises if neither can be
    written, as in a container that runs as another user than the one who installed.

    Raises:
        KinfeasError: If there is no folder for temporary files, or another user could write ours.
    """
    try:
        numba.njit(cache=True)(_any)
    except RuntimeError:
        os.environ["NUMBA_CACHE_DIR"] = str(_own_folder())
        numba.config.reload_config()  # type: ignore[no-untyped-call]


def _any() -> None:
    """Stand for any function of the package."""


def _own_folder() -> Path:
    """Return a folder that only this user can write: what lies in it is run."""
    try:
        folder = Path(tempfile.gettempdir()) / f"kinfeas-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
    except OSError as error:
        raise _nowhere(error.strerror or str(error)) from error
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o022:
        raise _nowhere(f"{folder} is not this user's alone")
    return folder


def _nowhere(reason: str) -> KinfeasError:
    return KinfeasError(
        f"there is no folder for compiled kernels ({reason}); let NUMBA_CACHE_DIR name one"
    )
