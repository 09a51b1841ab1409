"""Where episodes begin."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class Start:
    """Where n episodes begin and where their motions lead.

    Attributes:
        base_pose: World pose of the base, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        target_poses: What the motion of each sub-goal heads for, in the world, shape (n, sub-goals,
            7).
    """

    base_pose: Array
    joint_positions: Array
    target_poses: Array


def episode_rng(seed: int, episode: int, stream: Sequence[int] = ()) -> np.random.Generator:
    """Return the source of all randomness of an episode, from its beginning.

    Args:
        seed: Of all episodes.
        episode: Number of this one.
        stream: Tells the episodes of a seed apart from those of other streams.
    """
    return np.random.default_rng(np.random.SeedSequence((seed, episode), spawn_key=tuple(stream)))
