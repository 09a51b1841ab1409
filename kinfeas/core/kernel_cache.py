"""Where numba keeps what it has compiled."""

import os
import stat
import tempfile
from pathlib import Path

import numba

from kinfeas.core.errors import KinfeasError


def settle() -> None:
    """Let numba cache in a folder of the user's own where it can nowhere else.

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


def open_lock() -> int | None:
    """Return the descriptor of a file that processes of this user lock, or None if there is none.

    It lies in the user's own folder, and no symbolic link is followed to it.
    """
    try:
        return os.open(_own_folder() / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except (OSError, KinfeasError):
        return None


def _own_folder() -> Path:
    """Return a folder that only this user can write: what lies in it is run.

    It is `kinfeas` in the user's folder for caches, or beside other temporary files if that cannot
    be written.
    """
    try:
        return _private(_caches() / "kinfeas")
    except (OSError, RuntimeError):  # nor need there be a home
        pass
    try:
        return _private(Path(tempfile.gettempdir()) / f"kinfeas-{os.getuid()}")
    except OSError as error:
        raise _nowhere(error.strerror or str(error)) from error


def _caches() -> Path:
    told = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return told if told.is_absolute() else Path.home() / ".cache"


def _private(folder: Path) -> Path:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.lstat()
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o022:
        raise PermissionError(f"{folder} is not this user's alone")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{folder} cannot be written")
    return folder


def _nowhere(reason: str) -> KinfeasError:
    return KinfeasError(
        f"there is no folder for compiled kernels ({reason}); let NUMBA_CACHE_DIR name one"
    )
