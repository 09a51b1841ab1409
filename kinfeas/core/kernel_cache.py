"""Option of kernels, and folder and lock of numba's cache of them."""

import os
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import try_lock

UNCOUNTED: dict[str, Any] = {"_nrt": False}
"""Option of kernels that other kernels call: they count no references to arrays.

The counts take half of the time where many rows of arrays are passed on. A kernel with this option
allocates nothing, which numba checks, and returns no array.
"""

FAST = {"contract", "reassoc", "nsz"}
"""Flags of kernels whose sums may be regrouped and multiply-adds fused, always in the same way."""

_POLL, _DEADLINE = 0.02, time.monotonic() + 10.0
"""Seconds between attempts to lock, and the time after which an import does not wait."""


def settle() -> None:
    """Set numba's cache folder if neither the sources nor the user's cache are writable.

    Raises:
        KinfeasError: If no folder is writable by this user alone.
    """
    try:
        numba.njit(cache=True)(_any)
    except RuntimeError:
        os.environ["NUMBA_CACHE_DIR"] = str(_own_folder())
        numba.config.reload_config()  # type: ignore[no-untyped-call]


def compiled(signatures: Sequence[str], layout: str) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that compiles a generalized ufunc, in one process at a time.

    Numba caches such a function in two parts that refer to each other by names of the process. A
    cache filled by two processes at once would crash every later process.
    """

    def compile_alone(function: Callable[..., None]) -> Any:
        with _alone() as alone:
            decorate: Any = numba.guvectorize
            made = decorate(signatures, layout, nopython=True, cache=alone)(function)
        return made.ufunc  # numba's wrapper around it takes as long as a pose

    return compile_alone


@contextmanager
def _alone() -> Iterator[bool]:
    """Wait for the user's lock file; return whether this process may write the cache."""
    try:
        lock = os.open(_own_folder() / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except (OSError, KinfeasError):
        yield True  # without a folder there is no cache
        return
    try:
        while not (locked := try_lock(lock)) and time.monotonic() < _DEADLINE:
            time.sleep(_POLL)
        yield locked
    finally:
        os.close(lock)


def _any() -> None: ...  # stands for any kernel


def _own_folder() -> Path:
    """Return a folder that only this user can write, because its content is executed."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
        return _private((cache if cache.is_absolute() else Path.home() / ".cache") / "kinfeas")
    except (OSError, RuntimeError):  # not writable, or no home
        pass
    try:
        return _private(Path(tempfile.gettempdir()) / f"kinfeas-{os.getuid()}")
    except OSError as error:
        raise KinfeasError(
            f"no folder for compiled kernels ({error.strerror or error}); set NUMBA_CACHE_DIR"
        ) from error


def _private(folder: Path) -> Path:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = folder.lstat()
    others = not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid()
    if others or status.st_mode & 0o022 or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"other users can write {folder}")
    return folder
