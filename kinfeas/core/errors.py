"""The exception for bad input, and notes on the exceptions of plugins."""

import difflib
from collections.abc import Collection
from traceback import walk_tb
from types import TracebackType


class KinfeasError(ValueError):
    """Bad input: a file, key, value, URDF, plugin or policy.

    The message names the file, key or argument and what is wrong. The command line prints it
    without a traceback and exits with code 2.
    """


class Fault(KinfeasError):  # noqa: N818 - a state of the robot, and no mistake in the input
    """The reason why a run on a robot must stop: a measurement, a command, a clock or a link."""


def no_such(word: str, names: Collection[str]) -> str:
    """Return the end of an error on the unknown `word`: a guess, and the `names` that exist."""
    close = difflib.get_close_matches(word, names, n=1)
    guess = f" (did you mean {close[0]!r}?)" if close else ""
    return f"{guess}; known are {', '.join(sorted(set(names))) or 'none'}"


PLUGIN_ERRORS = (Exception, SystemExit)
"""Exceptions that the code of a plugin may raise."""

_RAISED_BY, _FRAMES = "raised by ", "plugin_frames"


class plugin_note:  # noqa: N801 - used like contextlib.suppress, and faster than a generator
    """A context that adds a note with the name of a plugin to the exceptions of its code."""

    def __init__(self, plugin: str) -> None:
        self.plugin = plugin

    def __enter__(self) -> None: ...

    def __exit__(
        self, kind: object, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, PLUGIN_ERRORS):
            error.add_note(_RAISED_BY + self.plugin)
            vars(error).setdefault(_FRAMES, len(list(walk_tb(trace))) - 1)


def raised_by(error: BaseException) -> str | None:
    """Return the plugin that raised an exception, by its `plugin_note`; None if there is none."""
    notes = [note for note in getattr(error, "__notes__", ()) if note.startswith(_RAISED_BY)]
    return notes[0].removeprefix(_RAISED_BY) if notes else None


def plugin_frames(error: BaseException) -> int:
    """Return the number of an exception's innermost frames from the plugin's code on, or 0."""
    return int(vars(error).get(_FRAMES, 0))


def describe(error: BaseException) -> str:
    """Return an exception in one line, with the plugin that raised it if that is known."""
    plugin = raised_by(error)
    if plugin is not None and type(error) is KinfeasError:
        return f"{plugin}: {error}"
    text = f"{type(error).__name__}: {error}"
    return text if plugin is None else f"{plugin} raised {text}"


def check_name(name: str) -> None:
    """Raise ValueError if the name of a robot or task does not fit into tables and file names."""
    if not name.strip() or "/" in name or not name.isprintable():
        raise ValueError(f"'name' must be printable, not empty and without '/', not {name!r}")


def check_ascending(name: str, bounds: tuple[float, float]) -> None:
    """Raise ValueError if the bounds of a range descend."""
    if bounds[0] > bounds[1]:
        raise ValueError(f"{name!r} must not descend from {bounds[0]:g} to {bounds[1]:g}")
