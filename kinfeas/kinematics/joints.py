"""How far arm joints go from one configuration to another."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

_ROUNDING = 1.001
"""Must not turn a motion at the very limit into a jump."""


def joint_way(robot: Robot, before: Array, after: Array) -> Array:
    """Return how far each joint has to go, the short way round where it has no end.

    Args:
        robot: Whose arm it is.
        before: Joint positions, shape (..., j), radians or metres.
        after: The same.

    Returns:
        Shape (..., j), radians or metres.
    """
    return np.where(robot.continuous, spatial.wrap(after - before), after - before)


def joint_jumps(robot: Robot, before: Array, after: Array, dt: float) -> NDArray[np.bool_]:
    """Return whether a joint would have to move faster than it can, shape (...).

    Args:
        robot: Whose arm it is.
        before: Joint positions, shape (..., j), radians or metres.
        after: Where they are to be `dt` seconds later.
        dt: Seconds.
    """
    longest = robot.max_joint_velocity * dt * _ROUNDING
    joint_jump: NDArray[np.bool_] = np.any(
        np.abs(joint_way(robot, before, after)) > longest, axis=-1
    )
    return joint_jump
