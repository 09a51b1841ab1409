"""Teleoperation: targets that come from people, models and trackers while a robot runs.

Sources have the entry points `kinfeas.target_sources`.
"""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from kinfeas.sim2real.servo.controller import TargetController


class TargetSource(Protocol):
    """Sends targets to a controller, from a thread of its own."""

    def start(self, controller: "TargetController") -> None:
        """Begin to send."""
        ...

    def close(self) -> None:
        """End; it may be called twice."""
        ...
