"""A robot: what its YAML file and its URDF say, as everything else takes it."""

import hashlib
import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.robots.spec import Drive, Gripper, PoseTolerance
from kinfeas.robots.urdf import Joint, Urdf

__all__ = ["ArmJoint", "Base", "Gripper", "PoseTolerance", "Robot"]


@dataclass(frozen=True)
class Base:
    """How the base drives.

    Attributes:
        drive: Whether it moves in any direction or only along its heading.
        max_velocity: m/s.
        max_rotation: rad/s.
        max_acceleration: m/s^2.
        max_rotation_acceleration: rad/s^2.
        frame: Root link, on the floor.
    """

    drive: Drive
    max_velocity: float
    max_rotation: float
    max_acceleration: float
    max_rotation_acceleration: float
    frame: str


@dataclass(frozen=True)
class ArmJoint:
    """A joint that IK moves; radians for turning joints, metres for sliding ones.

    Attributes:
        name: Name in the URDF.
        lower: Soft lower limit, -inf if continuous.
        upper: Soft upper limit, inf if continuous.
        velocity: Largest speed, per second.
        continuous: Whether it turns without end.
    """

    name: str
    lower: float
    upper: float
    velocity: float
    continuous: bool


@dataclass(frozen=True, eq=False)
class Robot:
    """All that is known of a robot.

    The arrays that its properties return are read-only.

    Attributes:
        name: Short name.
        urdf_path: File that physics engines load.
        urdf: What that file says.
        ee_frame: Link that motions move and IK places.
        tool_tip: Position of the tool tip in the EE frame, shape (3,), metres.
        gripper_rotation: Quaternion xyzw, shape (4,), from the common gripper convention (x is the
            approach, y the finger axis) to the EE frame: R_world_ee = R_world_gripper * it.
        base: How the base drives.
        arm: Joints that IK moves, from the root to the EE.
        fixed_joints: Positions of all other joints, except those that follow an arm joint.
        home: Named configurations of the arm, each of shape (j,); `home` is one of them.
        goal_heights: Lowest and highest EE goal in metres, for `ggr` and `ggr_restricted`.
        pose_tolerance: How far a pose may be missed and still count as feasible; None for not at
            all.
        ignored_collisions: Pairs of links that may touch, besides those next to each other.
        gripper: How the gripper closes; None if it does not.
        counterbalanced: Arm joints whose share of the arm's weight springs carry, not motors.
    """

    name: str
    urdf_path: Path
    urdf: Urdf
    ee_frame: str
    tool_tip: Array
    gripper_rotation: Array
    base: Base
    arm: tuple[ArmJoint, ...]
    fixed_joints: dict[str, float]
    home: dict[str, Array]
    goal_heights: dict[str, tuple[float, float]]
    pose_tolerance: PoseTolerance | None
    ignored_collisions: frozenset[frozenset[str]]
    gripper: Gripper | None
    counterbalanced: frozenset[str]

    @cached_property
    def continuous(self) -> NDArray[np.bool_]:
        """Whether each arm joint turns without end, shape (j,)."""
        return _read_only([joint.continuous for joint in self.arm])

    @cached_property
    def max_joint_velocity(self) -> Array:
        """Largest speed of each arm joint, shape (j,), rad/s or m/s."""
        return _read_only([joint.velocity for joint in self.arm])

    @cached_property
    def joint_limits(self) -> tuple[Array, Array]:
        """Soft limits, lower and upper, each of shape (j,), rad or m; infinite if continuous."""
        lower = _read_only([joint.lower for joint in self.arm])
        return lower, _read_only([joint.upper for joint in self.arm])

    @cached_property
    def finite_joint_limits(self) -> tuple[Array, Array]:
        """The same, but -pi and pi for continuous joints."""
        lower, upper = self.joint_limits
        lowest = np.where(self.continuous, -np.pi, lower)
        return _read_only(lowest), _read_only(np.where(self.continuous, np.pi, upper))


def _read_only(values: ArrayLike) -> NDArray[Any]:
    array = np.array(values)
    array.setflags(write=False)
    return array


_ROUNDING = 1.001
"""Must not turn a motion at the very limit into a jump."""


def joint_displacement(robot: Robot, before: Array, after: Array) -> Array:
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
        np.abs(joint_displacement(robot, before, after)) > longest, axis=-1
    )
    return joint_jump


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
