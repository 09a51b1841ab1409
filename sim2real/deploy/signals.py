"""Ctrl-C and its like as wishes that a loop looks at, instead of exceptions in its midst."""

import signal
from types import FrameType
from typing import Any

_WATCHED = (signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGHUP)


class Signals:
    """Takes note of signals while it is entered, which only the main thread can do.

    SIGHUP, of a terminal that was closed, is one of them, unless whoever started the process has it
    ignored, as nohup does.

    Attributes:
        caught: The first one that came, or None.
    """

    def __init__(self) -> None:
        self.caught: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Signals":
        """Begin to take note."""
        ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        watched = [one for one in _WATCHED if one is not signal.SIGHUP or not ignored]
        self._before = {one: signal.signal(one, self._take) for one in watched}
        return self

    def __exit__(self, *_: object) -> None:
        for one, handler in self._before.items():
            signal.signal(one, handler)

    def _take(self, number: int, _: FrameType | None) -> None:
        if self.caught is None:
            self.caught = signal.Signals(number)
        elif number != signal.SIGHUP:  # which a terminal and its shell both send
            # Whoever asks twice has waited in vain for the loop to look.
            raise KeyboardInterrupt
