"""Signals that end a run, noted for its loop."""

import signal
from types import FrameType
from typing import Any, Self


class Signals:
    """A context that notes SIGINT, SIGQUIT, SIGTERM and SIGHUP for a loop, in the main thread.

    SIGHUP is left alone if it is ignored, as by nohup. A second signal raises KeyboardInterrupt.

    Attributes:
        caught: First signal, or None.
    """

    def __init__(self) -> None:
        self.caught: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        noted = [signal.SIGINT, signal.SIGQUIT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            noted.append(signal.SIGHUP)
        self._before = {number: signal.signal(number, self._note) for number in noted}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, _: FrameType | None) -> None:
        if self.caught is None:
            self.caught = signal.Signals(number)
        elif number != signal.SIGHUP:  # which a terminal and its shell both send
            raise KeyboardInterrupt
