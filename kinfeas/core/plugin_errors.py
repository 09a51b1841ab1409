"""Code of others: what it raises becomes one sentence that says whose code and where."""

import traceback
from pathlib import Path
from types import TracebackType

from kinfeas.core.errors import KinfeasError

_OWN = "kinfeas"

# A sentence already, or the machine's trouble.
_NOBODYS = (KinfeasError, MemoryError, SystemError)

BLAMED = (Exception, SystemExit)
"""What code of others may raise: somebody at the keyboard may wish to end the program, a plugin may
not. To be caught, and given to `PluginErrors.blame`, where a context would cost much."""


def is_own(thing: object) -> bool:
    """Return whether the class of an object is our own code."""
    return package_of(thing) == _OWN


def package_of(thing: object) -> str:
    """Return the top-level package that the class of an object comes from."""
    return type(thing).__module__.partition(".")[0]


class PluginErrors:
    """A context in which any `Exception`, and `SystemExit`, becomes a `KinfeasError`.

    It is for a single call into a plugin, whose author may raise what he likes. `KeyboardInterrupt`
    passes as it is, and so do `MemoryError`, errors that are a sentence already, and what our own
    package raises, which keeps its traceback. It may be entered again and again.

    Args:
        subject: Whose code it is, and what it is asked for, as the sentence begins.
        package: Top-level package of that code; the line to blame is the last one in it.
    """

    def __init__(self, subject: str, package: str = "") -> None:
        self.subject, self.package = subject, package

    def __enter__(self) -> None:
        """Begin the call."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Raise instead of `error`, if there is one, as `blame` does."""
        if error is not None:
            self.blame(error)

    def blame(self, error: BaseException) -> None:
        """Raise what says whose mistake `error` is, or return if it is nobody's.

        Raises:
            KinfeasError: Names the subject, what it raised, and the line.
        """
        if not isinstance(error, BLAMED) or isinstance(error, _NOBODYS):
            return
        # A library that is not installed is no mistake of ours.
        if self.package == _OWN and not isinstance(error, ImportError):
            return
        place = _last_line(error.__traceback__, self.package)
        raise KinfeasError(f"{self.subject} {type(error).__name__}: {error}{place}") from error


def _last_line(trace: TracebackType | None, package: str) -> str:
    """Return the line of a package that was reached last, in brackets, or nothing."""
    lines = [
        f" ({Path(frame.f_code.co_filename).name}, line {number})"
        for frame, number in traceback.walk_tb(trace)
        if package and frame.f_globals.get("__name__", "").partition(".")[0] == package
    ]
    return lines[-1] if lines else ""
