"""Starts and random numbers of episodes."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class Start:
    """Starts and targets of n episodes.

    Attributes:
        base_pose: World pose of the base, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        target_poses: World target pose of each sub-goal, shape (n, sub-goals, 7).
    """

    base_pose: Array
    joint_positions: Array
    target_poses: Array


def stacked(starts: Sequence[Start]) -> Start:
    """Return starts without leading axes as one with a leading axis."""
    names = [one.name for one in fields(Start)]
    return Start(**{name: np.stack([getattr(one, name) for one in starts]) for name in names})


def episode_rng(seed: int, episode: int, stream: Sequence[int] = ()) -> np.random.Generator:
    """Return the random generator of an episode; `stream` separates those of equal numbers."""
    return np.random.default_rng(np.random.SeedSequence((seed, episode), spawn_key=tuple(stream)))
