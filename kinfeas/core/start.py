"""Starts and random numbers of episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.solids import Solids, stacked_solids
from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class Start:
    """Starts and targets of n episodes."""

    base_pose: Array  # world pose of the base, shape (n, 7)
    joint_positions: Array  # arm joints, shape (n, j), radians or metres
    target_poses: Array  # world target pose of each sub-goal, shape (n, sub-goals, 7)
    # solids around the robots, n rows, or one for starts without leading axes; None for none
    solids: Solids | None = None

    def of(self, rows: NDArray[np.intp]) -> "Start":
        """Return some of n starts."""
        solids = None if self.solids is None else self.solids.of(rows)
        poses = self.base_pose[rows], self.joint_positions[rows], self.target_poses[rows]
        return Start(*poses, solids)


def stacked(starts: Sequence[Start]) -> Start:
    """Return starts without leading axes as one batch."""
    solids = None
    if any(start.solids is not None for start in starts):
        solids = stacked_solids([start.solids or Solids.empty(1) for start in starts])
    return Start(
        np.stack([start.base_pose for start in starts]),
        np.stack([start.joint_positions for start in starts]),
        np.stack([start.target_poses for start in starts]),
        solids,
    )


def episode_rng(seed: int, episode: int, stream: Sequence[int] = ()) -> np.random.Generator:
    """Return the random generator of an episode; `stream` separates sets of numbered episodes."""
    return np.random.default_rng(np.random.SeedSequence((seed, episode), spawn_key=tuple(stream)))
