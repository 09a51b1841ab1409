"""Solids around the robots of a loop, and scans of them, where the backend has them."""

import logging

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE, Backend, RobotState
from kinfeas.core.errors import plugin_note
from kinfeas.core.motion import Rows
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.self_collision import CollisionModel
from kinfeas.kinematics.solids import collides

_log = logging.getLogger(__name__)


class Surroundings:
    """Solids of a backend and its scans.

    A robot in real time whose backend has no solids is assumed to be among those of its start.
    """

    def __init__(self, backend: Backend, shapes: CollisionModel) -> None:
        self._backend, self._shapes = backend, shapes
        self._assumed = MovingSolids() if backend.real_time and backend.solids is None else None
        self._solids = backend.solids or self._assumed
        self._note = plugin_note(f"backend {backend.name}")
        self._warned = False

    def place(self, solids: Solids | None, rows: Rows) -> None:
        """Put solids around the robots of some rows, None for none."""
        if self._assumed is not None:
            self._assumed.place(solids, rows, len(rows))
        else:
            self._backend.place_solids(solids, rows)

    def after(self, seconds: float) -> Solids | None:
        """Return the solids as they will stand in some seconds, or None without any."""
        return None if self._solids is None else self._solids.after(seconds)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which rows have solids that move, shape (n,); only where there are solids."""
        assert self._solids is not None
        return self._solids.moving

    def collisions(self, robots: RobotState) -> NDArray[np.bool_] | None:
        """Return whether base and arm touch a solid, shape (n, 2); None without any."""
        if (solids := self.after(0.0)) is None:
            return None
        true_state = robots.true_state or robots
        return collides(self._shapes, true_state.joint_positions, true_state.base_pose, solids)

    def ranges(self, n: int) -> Array:
        """Return the ranges around n bases, as in `Scan`; without a scan nothing is in range."""
        if self._backend.scanner is not None:
            with self._note:
                return self._backend.scanner.scan().ranges
        if not self._warned:
            _log.warning("%s has no scan: the policy observes no obstacles", self._note.plugin)
            self._warned = True
        return np.full((n, 2, SCAN_BEAMS), SCAN_RANGE)
