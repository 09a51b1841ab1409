"""A short text by which two programs know that they mean the same robot."""

import hashlib
import json
import math

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.robots.robot import Robot
from kinfeas.robots.tree import Joint

DIGITS = 9
"""Decimals that count: nanometres and nanoradians, far above what rounding does."""


def fingerprint(robot: Robot) -> str:
    """Return `sha256:` and the hash of a robot's kinematics, 64 hexadecimal digits.

    It covers what gives a policy's observation and action their meaning: the names of the base
    frame and of the EE frame, the joints on the way between them, each with its origin, its axis
    and where it stands or what it follows, the names and soft limits of the arm's joints in order,
    and how the base drives and how fast.

    It leaves out what may be mended or tuned under a trained policy: shapes for self-collision,
    pose_tolerance, accelerations, velocities of the arm's joints, the tool tip and the gripper,
    masses, named configurations, goal heights, and the names of links along the way.
    """
    facts = {
        "frames": [robot.base.frame, robot.ee_frame],
        "base": [robot.base.drive, *_rounded(robot.base.max_velocity, robot.base.max_rotation)],
        "arm": [[joint.name, *_rounded(joint.lower, joint.upper)] for joint in robot.arm],
        "path": [_joint(robot, joint) for joint in robot.urdf.path_to(robot.ee_frame)],
    }
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _joint(robot: Robot, joint: Joint) -> list[object]:
    # A matrix, for a quaternion of half a turn has no sign that rounding would leave alone.
    turn = Rotation.from_quat(joint.origin[3:]).as_matrix()
    origin = _rounded(*joint.origin[:3], *turn.ravel())
    return [joint.kind, origin, _rounded(*joint.axis), *_position(robot, joint)]


def _position(robot: Robot, joint: Joint) -> list[object]:
    """Return what the joint's position is, or what it follows: the arm's joint, times, plus."""
    if not joint.moves:
        return []
    leader, scale, offset = robot.urdf.followed(joint)
    if leader.name not in {one.name for one in robot.arm}:
        return _rounded(robot.fixed_joints[joint.name])
    return [leader.name, *_rounded(scale, offset)]


def _rounded(*values: float) -> list[object]:
    """Return numbers as JSON takes them: rounded, without a negative zero, null for infinity."""
    return [
        float(np.round(value, DIGITS)) + 0.0 if math.isfinite(value) else None for value in values
    ]
