"""What a policy sees of the robot and of the motion it serves."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import IDENTITY, Array, integrate, relative, twist_between

HORIZON = 0.1
"""Seconds of planned motion that an observation shows, whatever the control rate."""

FIELDS = (
    ("ee_position", 3),
    ("ee_orientation", 4),
    ("planned_velocity", 3),
    ("planned_rotation", 4),
    ("goal_position", 3),
    ("goal_orientation", 4),
)
"""Names and sizes of the fields before the joint positions, all in the base frame."""


def size(joints: int) -> int:
    """Return how many numbers an observation of a robot with `joints` arm joints has."""
    return sum(count for _, count in FIELDS) + joints


def observe(
    base_pose: Array, ee_in_base: Array, planned: Array, goal: Array, joint_positions: Array
) -> Array:
    """Return what the policy sees, all in the current base frame.

    The planned motion is measured from the *achieved* EE pose, so that it holds the error to
    catch up with.

    Args:
        base_pose: World pose of the base, shape (n, 7).
        ee_in_base: Achieved EE pose in the base frame, shape (n, 7).
        planned: World pose that the generator plans for the EE in `HORIZON` seconds, shape (n, 7).
        goal: World pose at which the EE's motion ends, shape (n, 7).
        joint_positions: Arm joints, continuous ones in (-pi, pi], shape (n, j).

    Returns:
        Shape (n, 21 + j): EE pose 7, planned velocity 3 (m/s) and rotation change 4 (quaternion
        over `HORIZON` seconds), goal pose 7, joints j. Quaternions are xyzw with w >= 0.
    """
    planned_in_base = relative(planned, base_pose)
    goal_in_base = relative(goal, base_pose)
    catch_up = twist_between(ee_in_base, planned_in_base, HORIZON)
    change = integrate(IDENTITY, catch_up, HORIZON)[:, 3:]
    return np.concatenate(
        [ee_in_base, catch_up[:, :3], change, goal_in_base, joint_positions], axis=1
    )


def scale(joints: int) -> Array:
    """Return factors that bring each number of an observation to about unit range, (21 + j,).

    An EE that moves 0.1 m/s and 0.1 rad/s turns by a quaternion of about 0.005 in `HORIZON`.
    """
    factors = {"planned_velocity": 5.0, "planned_rotation": 20.0, "goal_position": 0.5}
    scales = [np.full(count, factors.get(name, 1.0)) for name, count in FIELDS]
    joined = np.concatenate([*scales, np.full(joints, 0.5)])
    joined[sum(count for _, count in FIELDS[:4]) - 1] = 1.0  # the w of the planned rotation
    return joined


CLIP = 3.0
"""Bound of a scaled number: an EE far off its path would drown all others."""


def scaled(seen: Array, factors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return observations, shape (n, 21 + j), as networks take them in."""
    return np.clip(seen.astype(np.float32) * factors, -CLIP, CLIP)
