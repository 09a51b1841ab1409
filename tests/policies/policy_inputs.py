"""What policies see of robots with random arms on random places."""

import numpy as np

from kinfeas.control.observation import HORIZON, ObservedState, observe
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import compose, integrate, planar_pose
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.ik import spread_configurations


def policy_inputs(robot, count, twist=None, seed=0, base_pose=None, joints=None):
    """Return `count` situations in which the EE is to move by `twist`, (6,), or at random."""
    rng = np.random.default_rng(seed)
    if joints is None:
        joints = spread_configurations(robot, count, seed)
    if base_pose is None:
        base_pose = planar_pose(*rng.uniform(-2.0, 2.0, (2, count)), rng.uniform(-3.0, 3.0, count))
    if twist is None:
        twist = rng.uniform(-0.1, 0.1, (count, 6))
    in_base = forward(build_chain(robot), joints)
    ee = compose(base_pose, in_base)
    planned = integrate(ee, np.broadcast_to(twist, (count, 6)), HORIZON)
    seen = observe(ObservedState(base_pose, in_base, planned, planned, joints))
    nothing = np.full((count, 7), np.nan)
    return Observation(seen, base_pose, ee, joints, ee, planned, nothing, nothing, HORIZON)
