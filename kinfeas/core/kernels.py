"""Decorators that compile kernels with numba, and the folder and lock of numba's cache.

`kernel` is for functions that Python calls, `inner` and `inlined` for those that kernels call;
`exact`, `exact_inner` and `exact_inlined` compute sums in the written order. `compiled` makes a
generalized ufunc.

Results are deterministic; divisions have no check for zero. Functions that compute numbers for
other kernels are inlined: otherwise each kernel has its own, regrouped copy, and the kernels that a
process compiled before determine which copy runs. No kernel has a `**`, since numba compiles it
once in a process, with the flags of the first kernel.
"""

import logging
import os
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core.event import Event, Listener, register

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import try_lock

# Explicit, because a kernel without an option inherits its first caller's.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}
# Sums may be regrouped and multiply-adds fused, always in the same way.
_FAST = {**_OPTIONS, "fastmath": {"contract", "reassoc", "nsz"}}
_EXACT = {**_OPTIONS, "fastmath": False}
_CALLED: dict[str, Any] = {"nogil": True, "forceinline": False}
# Counts of references to arrays take half of the time where many rows of arrays are passed on.
# Without them a kernel allocates nothing, which numba checks, and returns no array.
_UNCOUNTED: dict[str, Any] = {"_nrt": False}

kernel = njit(**_FAST, **_CALLED)
inner = njit(**_FAST, **_CALLED, **_UNCOUNTED)
inlined = njit(**_FAST, forceinline=True, **_UNCOUNTED)
exact = njit(**_EXACT, **_CALLED)
exact_inner = njit(**_EXACT, **_CALLED, **_UNCOUNTED)
exact_inlined = njit(**_EXACT, forceinline=True)

_log = logging.getLogger(__name__)

_POLL, _DEADLINE = 0.02, time.monotonic() + 10.0
"""Seconds between attempts to lock, and the time after which an import does not wait."""


class _CompilationNotice(Listener):
    """Logs once, in the main process, that kernels without a cache are being compiled."""

    logged = False

    def on_start(self, event: Event) -> None:
        ours = event.data["dispatcher"].__module__.startswith("kinfeas.")
        if ours and not self.logged and parent_process() is None:
            self.logged = True
            _log.warning("compiling kernels (kept for next time)")

    def on_end(self, event: Event) -> None: ...


def _set_cache_folder() -> None:
    """Set numba's cache folder if neither the sources nor the user's cache folder is writable.

    Raises:
        KinfeasError: If no folder is writable by this user alone.
    """
    try:
        njit(cache=True)(_probe)
    except RuntimeError:
        os.environ["NUMBA_CACHE_DIR"] = str(_own_folder())
        numba.config.reload_config()


def compiled(signatures: Sequence[str], layout: str) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that compiles a generalized ufunc, in one process at a time.

    Numba caches such a function in two parts, which refer to each other by names that differ in
    each process. A cache filled by two processes at once would crash every later process.
    """

    def compile_alone(function: Callable[..., None]) -> Any:
        with _cache_lock() as locked:
            decorate: Any = numba.guvectorize
            made = decorate(signatures, layout, nopython=True, cache=locked)(function)
        return made.ufunc  # numba's wrapper would take as long as the arithmetic of a pose

    return compile_alone


@contextmanager
def _cache_lock() -> Iterator[bool]:
    """Wait for the user's lock file; return whether this process may write the cache."""
    try:
        lock = os.open(_own_folder() / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except (OSError, KinfeasError):
        yield True  # no folder for a lock
        return
    try:
        while not (locked := try_lock(lock)) and time.monotonic() < _DEADLINE:
            time.sleep(_POLL)
        yield locked
    finally:
        os.close(lock)


def _probe() -> None: ...  # stands for any kernel


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
    foreign = not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid()
    if foreign or status.st_mode & 0o022 or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"other users can write {folder}")
    return folder


_set_cache_folder()  # before the first kernel
register("numba:compile", _CompilationNotice())


@inlined
def copy_row(values, out):
    """Copy values, shape (n,); a slice assignment takes much longer to compile."""
    for i in range(len(values)):
        out[i] = values[i]


@inlined
def square(value):
    """Return the square."""
    return value * value
