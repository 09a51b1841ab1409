"""When messages were sent, by our clock, despite queues, wrong stamps and clocks that are set."""

import math

from kinfeas.sim2real.link.measurements import DRIFT

_MESSAGES, _SECONDS = 5, 0.5
"""Least number of messages, and seconds between the first and the last, that show another offset of
the clocks."""

_PATIENCE, _FACTOR = 10.0, 10.0
"""The same seconds for messages that a slow queue may explain, at least and per second of delay."""


class SenderClock:
    """Estimates when stamped messages were sent, by our clock.

    The offset of the clocks is the smallest difference of arrival and stamp so far; it grows by
    `DRIFT`, since the sender's clock may be slow. Messages with another difference waited in a
    queue or have a wrong stamp, and leave the offset as it is, unless `_MESSAGES` in a row agree on
    another one: for `_SECONDS` if no queue can be the reason, since they are ahead of the offset or
    older than a message before; for `_FACTOR` times their delay otherwise.
    """

    def __init__(self, tolerance: float) -> None:
        """Start without a message; those later by more than `tolerance` seconds are in doubt."""
        self._tolerance = tolerance
        self._offset, self._newest = math.inf, -math.inf
        self._count, self._began, self._delay, self._least = 0, 0.0, 0.0, 0.0
        self._no_queue = False

    def sent(self, stamp: float, arrival: float) -> float | None:
        """Return when a message was sent, seconds of our clock and at most `arrival`.

        None if that is later than `arrival` by more than half of the tolerance.

        Args:
            stamp: By the sender's clock, seconds.
            arrival: By our clock, seconds.
        """
        delay = arrival - stamp
        if self._newest == -math.inf:
            self._offset, self._newest = delay, stamp
        offset = self._offset + DRIFT * max(0.0, stamp - self._newest)
        late = delay - offset
        if -0.5 * self._tolerance <= late <= self._tolerance:
            self._offset, self._newest = min(delay, offset), max(stamp, self._newest)
            self._count = 0
        elif self._agreed(stamp, arrival, late):
            self._offset, self._newest, self._count = self._least, stamp, 0
        elif not late > 0.0:
            return None
        return min(arrival, stamp + self._offset)

    def _agreed(self, stamp: float, arrival: float, late: float) -> bool:
        """Return whether messages in doubt, this being the last, agree on another offset."""
        delay, no_queue = arrival - stamp, late < 0.0 or stamp < self._newest
        agrees = abs(delay - self._delay) <= self._tolerance and no_queue == self._no_queue
        if self._count == 0 or not agrees:
            self._count, self._began, self._delay, self._least = 0, arrival, delay, delay
            self._no_queue = no_queue
        self._count, self._least = self._count + 1, min(self._least, delay)
        seconds = _SECONDS if no_queue else max(_PATIENCE, _FACTOR * late)
        return self._count >= _MESSAGES and arrival - self._began >= seconds
