"""The robot model: base, arm, gripper and URDF; joint displacements and the fingerprint."""

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

from kinfeas.core import pose_kernels
from kinfeas.core.errors import KinfeasError
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.robots.spec import (
    GUESSED_VELOCITY,
    MAX_JOINT_VELOCITY,
    BaseSpec,
    GripperSpec,
    PoseTolerance,
    Reach,
)
from kinfeas.robots.urdf import Joint, Urdf

_ROUNDING = 1.001  # factor on the velocity limits, so that a motion at the limit is no joint jump
_DIGITS = 9  # decimals in the fingerprint: nanometres and nanoradians, far above rounding errors


@dataclass(frozen=True)
class Base(BaseSpec):
    """Drive and limits of the base, and `frame`, its root link on the floor."""

    frame: str


@dataclass(frozen=True)
class ArmJoint:
    """A joint that IK moves: soft limits, rad or m, infinite if continuous, and velocity limit."""

    name: str
    lower: float
    upper: float
    velocity: float
    continuous: bool


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot. The arrays that its properties return are read-only.

    In the common gripper convention x is the approach and y the finger axis.
    """

    name: str  # short name
    folder: Path  # folder of its files: recipes, ROS topics, trained policies
    urdf_path: Path  # file that physics engines load
    urdf: Urdf  # links and joints of that file
    ee_frame: str  # link that motions move and IK places
    tool_tip: Array  # position of the tool tip in the EE frame, shape (3,), metres
    gripper_rotation: Array  # R_gripper_ee from the common gripper convention, xyzw, shape (4,)
    base: Base  # drive and limits of the base
    arm: tuple[ArmJoint, ...]  # joints that IK moves, from the root to the EE
    fixed_joints: dict[str, float]  # positions of all other joints that mimic no joint of the arm
    home: dict[str, Array]  # configurations of the arm, (j,), one of them `home`
    reach: Reach  # heights of EE goals
    pose_tolerance: PoseTolerance | None  # error that counts as feasible; None for exact IK
    ignored_collisions: frozenset[frozenset[str]]  # pairs that may touch; adjacent links always may
    gripper: GripperSpec | None  # finger joints and their positions; None without a gripper
    counterbalanced: frozenset[str]  # arm joints whose gravity load is carried by springs
    max_gravity_load: float | None  # fraction of the effort limits; None for no limit
    response: ResponseModel  # of the real robot

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, {len(self.arm)} arm joints, {str(self.folder)!r})"

    @cached_property
    def continuous(self) -> NDArray[np.bool_]:
        """Whether each arm joint is continuous, shape (j,)."""
        return _read_only([joint.continuous for joint in self.arm])

    @cached_property
    def max_joint_velocity(self) -> Array:
        """Velocity limit of each arm joint, shape (j,), rad/s or m/s."""
        return _read_only([joint.velocity for joint in self.arm])

    @cached_property
    def joint_limits(self) -> tuple[Array, Array]:
        """Soft limits, lower and upper, each of shape (j,), rad or m; infinite if continuous."""
        lower = _read_only([joint.lower for joint in self.arm])
        return lower, _read_only([joint.upper for joint in self.arm])

    @cached_property
    def finite_joint_limits(self) -> tuple[Array, Array]:
        """Joint limits for random starts, lower and upper, each of shape (j,), rad or m.

        Rotating joints have at most one turn about 0 if continuous, else about the middle of the
        range, so that there is room in both directions.
        """
        lower, upper = self.joint_limits
        slides = np.array([self.urdf.joints[joint.name].kind == "prismatic" for joint in self.arm])
        middle = np.where(self.continuous, 0.0, self.joint_limits).mean(axis=0)
        half = np.where(slides, np.inf, np.pi)
        return (
            _read_only(np.maximum(lower, middle - half)),
            _read_only(np.minimum(upper, middle + half)),
        )

    def finger_velocity(self, finger: str) -> float:
        """Return the velocity limit of a finger joint, rad/s or m/s."""
        joint, gripper = self.urdf.joints[finger], self.gripper
        own = None if gripper is None else gripper.velocity
        limit = joint.velocity if joint.velocity <= MAX_JOINT_VELOCITY else None
        return own or limit or GUESSED_VELOCITY[joint.kind]


def _read_only(values: ArrayLike) -> NDArray[Any]:
    array = np.array(values)
    array.setflags(write=False)
    return array


def joint_displacement(robot: Robot, before: Array, after: Array) -> Array:
    """Return the displacement of each joint, (..., j), in (-pi, pi] for continuous joints."""
    return pose_kernels.joint_displacement(before, after, robot.continuous)


def exceeds_joint_velocity(
    robot: Robot, before: Array, after: Array, dt: float
) -> NDArray[np.bool_]:
    """Return whether any joint exceeds its velocity limit in `dt` seconds, (..., j) -> (...)."""
    longest = robot.max_joint_velocity * dt * _ROUNDING
    return pose_kernels.moves_farther(before, after, robot.continuous, longest)


def fingerprint(robot: Robot) -> str:
    """Return `sha256:` and the hash of the kinematics that a policy depends on.

    The hash covers the base and EE frames, the joints between them (type, origin, axis, position or
    mimic), the names and soft limits of the arm's joints, and drive and velocity limits of the
    base. A trained policy stays valid under all other changes: collision shapes, tolerances,
    accelerations, joint velocities, tool tip, gripper, masses, configurations and reach.
    """
    facts = {
        "frames": [robot.base.frame, robot.ee_frame],
        "base": [robot.base.drive, *_rounded(robot.base.max_velocity, robot.base.max_rotation)],
        "arm": [[joint.name, *_rounded(joint.lower, joint.upper)] for joint in robot.arm],
        "path": [_joint(robot, joint) for joint in robot.urdf.path_to(robot.ee_frame)],
    }
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def check_same_robot(robot: Robot, name: str, kinematics: str | None, source: str) -> None:
    """Raise KinfeasError unless a policy for the robot `name` is for `robot`.

    `kinematics` is the fingerprint of the policy's robot, None if unknown.
    """
    if name != robot.name:
        raise KinfeasError(f"{source}: a policy for robot {name!r}, not for {robot.name!r}")
    if kinematics not in {None, fingerprint(robot)}:
        raise KinfeasError(
            f"{source}: trained with other kinematics of {name!r}: joints, limits, EE frame, or "
            "the base's drive or speed"
        )


def _joint(robot: Robot, joint: Joint) -> list[object]:
    # A matrix, since the sign of a quaternion of a half turn depends on rounding.
    rotation = Rotation.from_quat(joint.origin[3:]).as_matrix()
    origin = _rounded(*joint.origin[:3], *rotation.ravel())
    return [joint.kind, origin, _rounded(*joint.axis), *_position(robot, joint)]


def _position(robot: Robot, joint: Joint) -> list[object]:
    if not joint.moves:
        return []
    leader, scale, offset = robot.urdf.followed(joint)
    if leader.name not in {arm_joint.name for arm_joint in robot.arm}:
        return _rounded(robot.fixed_joints[joint.name])
    return [leader.name, *_rounded(scale, offset)]


def _rounded(*values: float) -> list[object]:
    # JSON has no infinity; the sum turns -0 into 0.
    return [float(np.round(x, _DIGITS)) + 0.0 if math.isfinite(x) else None for x in values]
