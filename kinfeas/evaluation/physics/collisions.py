"""How often a robot runs into things: encounters, not the flicker of their contacts."""

from collections.abc import Collection

_APART = 0.5  # s


class Encounters:
    """Counts what is run into, each thing once until it has been left alone for half a second.

    A base that scrapes along a table touches it, bounces off and touches it again, many times a
    second: that is one encounter. Whatever else it touches meanwhile is another one.

    Attributes:
        count: How many there were.
    """

    def __init__(self, dt: float) -> None:
        """Begin to count in control periods of `dt` seconds."""
        self.count = 0
        self._apart, self._period = round(_APART / dt), 0
        self._last: dict[int, int] = {}

    def add(self, touched: Collection[int]) -> None:
        """Take in which things are touched at the end of a control period, by their numbers."""
        self._period += 1
        for thing in touched:
            last = self._last.get(thing)
            self.count += last is None or self._period - last > self._apart
            self._last[thing] = self._period
