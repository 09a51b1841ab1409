"""Ctrl-C and SIGTERM as wishes that a loop looks at, instead of exceptions in its midst."""

import signal
from types import FrameType
from typing import Any

_WATCHED = (signal.SIGINT, signal.SIGTERM)


class Signals:
    """Takes note of signals while it is entered, which only the main thread can do.

    Attributes:
        caught: The first one that came, or None.
    """

    def __init__(self) -> None:
        self.caught: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Signals":
        """Begin to take note."""
        self._before = {one: signal.signal(one, self._take) for one in _WATCHED}
        return self

    def __exit__(self, *_: object) -> None:
        for one, handler in self._before.items():
            signal.signal(one, handler)

    def _take(self, number: int, _: FrameType | None) -> None:
        # Whoever asks twice has waited in vain for the loop to look.
        if self.caught is not None:
            raise KeyboardInterrupt
        self.caught = signal.Signals(number)
