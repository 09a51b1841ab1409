"""Where in the base frame the EE was asked to be: a few thousand points of an evaluation."""

import numpy as np

from kinfeas.control.loop import Rows
from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.envs.world import Transition, World

EVERY = 20
"""Steps of an episode between two points of feasible steps."""

MOST = 2000
"""Points of each kind that are kept, spread evenly over all."""


class WorkspaceSamples:
    """Points gathered by `run_episodes`: every failure, and some of the feasible steps.

    A point is the desired EE position in the frame of the base at that moment; on a feasible step
    the EE is there.
    """

    def __init__(self) -> None:
        self._feasible: list[Array] = []
        self._infeasible: list[Array] = []

    def __call__(self, world: World, transition: Transition, rows: Rows, _: Rows) -> None:
        """Take in one step; called as `episodes.Watch`."""
        loop, good = world.loop, transition.step.feasible[rows]
        failed, due = rows[~good], rows[good & (world.steps[rows] % EVERY == 0)]
        for kept, which in ((self._infeasible, failed), (self._feasible, due)):
            if which.size:
                inside = spatial.relative(loop.desired[which], loop.state.base_pose[which])
                kept.append(inside[:, :3])

    def kept(self) -> dict[str, list[list[float]]]:
        """Return the points x, y, z of both kinds in metres, rounded to the millimetre."""
        return {"feasible": _rounded(self._feasible), "infeasible": _rounded(self._infeasible)}


def thinned(points: Array, most: int) -> Array:
    """Return at most `most` of the points, shape (k, 3), spread evenly over all."""
    chosen = np.linspace(0, len(points) - 1, min(most, len(points))).round().astype(int)
    return points[chosen]


def _rounded(parts: list[Array]) -> list[list[float]]:
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    kept: list[list[float]] = np.round(thinned(points, MOST), 3).tolist()
    return kept
