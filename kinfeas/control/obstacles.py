"""Obstacles around the robots of a loop: solids and scans, where the backend has them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.core.backend import (
    Backend,
    RealTimeBackend,
    RobotState,
    SupportsScan,
    SupportsSolids,
)
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.motion import Rows
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.self_collision import CollisionModel
from kinfeas.kinematics.solids import collides


class Obstacles:
    """Solids of the innermost backend, and scans as its adapters change them.

    A robot that moves in real time has no solids of its own; those of its start are known.
    """

    def __init__(self, backend: Backend, shapes: CollisionModel) -> None:
        """Look for the abilities of a backend; `shapes` are those of its robots."""
        *_, innermost = chain(backend)
        # Once, since protocols are checked by looking up each of their members.
        self._backend = innermost if isinstance(innermost, SupportsSolids) else None
        self._known = MovingSolids() if isinstance(innermost, RealTimeBackend) else None
        self._scanner = backend if isinstance(backend, SupportsScan) else None
        self._note, self._shapes = plugin_note(f"backend {type(innermost).__name__}"), shapes

    def place(self, solids: Solids | None, rows: Rows) -> None:
        """Put solids around the robots of some rows, None for none."""
        if self._backend is not None:
            self._backend.place_solids(solids, rows)
        elif self._known is not None:
            self._known.place(solids, rows, len(rows))
        elif solids is not None:
            raise KinfeasError(f"{self._note.plugin} has no solids, which the task needs")

    def after(self, seconds: float) -> Solids | None:
        """Return the solids as they will stand in some seconds, or None without any."""
        return None if self._solids is None else self._solids.after(seconds)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which rows have solids that move, shape (n,); only where there are solids."""
        assert self._solids is not None
        return self._solids.moving

    def collisions(self, state: RobotState) -> NDArray[np.bool_] | None:
        """Return whether base and arm touch a solid, shape (n, 2); None without any."""
        if (solids := self.after(0.0)) is None:
            return None
        true_state = state.true_state or state
        return collides(self._shapes, true_state.joint_positions, true_state.base_pose, solids)

    def scan(self) -> Array:
        """Return the ranges around the bases, as `SupportsScan` does."""
        if self._scanner is None:
            raise KinfeasError(f"{self._note.plugin} has no scan, which the policy needs")
        with self._note:
            return self._scanner.scan()

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the solids as arrays by name."""
        return {} if self._solids is None else self._solids.snapshot()

    @property
    def _solids(self) -> MovingSolids | None:
        return self._known if self._backend is None else self._backend.solids
