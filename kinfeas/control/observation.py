"""Observation terms and actions of policies."""

import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import TermInfo
from kinfeas.core.spatial import Array, catch_up, relative
from kinfeas.kinematics.drive import command_size
from kinfeas.robots.robot import Robot

HORIZON = 0.1  # seconds of planned motion that an observation shows, at any control rate
CLIP = 3.0  # bound of a scaled number, so that no EE far from its path dominates the others

AHEAD = np.array([0.5, 1.0, 1.5])
"""Distances along the planned motion at which an observation shows it, metres."""

_CLOSENESS = f"1 - range / {SCAN_RANGE:g} m"

QUATERNION = "quaternion xyzw, w >= 0"


class ObservedState:
    """State of n robots in their base frames, from which the terms are computed.

    Attributes:
        ee: Achieved EE pose, shape (n, 7).
        goal: Pose at which the EE's motion ends, shape (n, 7).
        velocity: Linear velocity from the achieved to the planned EE pose, shape (n, 3), m/s. It
            contains the tracking error.
        rotation: Rotation change over `HORIZON` seconds, shape (n, 4).
        joint_positions: Arm joints, continuous ones in (-pi, pi], shape (n, j).
    """

    # None unless a term needs them:
    previous_command: Array | None = None  # base command of the last period, shape (n, c)
    ahead: Array | None = None  # positions `AHEAD` on the planned motion, shape (n, 3 d), metres
    planned_base: Array | None = None  # x, y and yaw on a whole-body path, shape (n, 3)
    ranges: Array | None = None  # ranges of a scan, shape (n, 2, beams), metres

    def __init__(
        self, base_pose: Array, ee_in_base: Array, planned: Array, goal: Array, joints: Array
    ) -> None:
        """Compute the relative poses.

        `base_pose`, `planned` (the EE's in `HORIZON` seconds) and `goal` are world poses, shape
        (n, 7); `ee_in_base` is achieved. Joints have shape (n, j).
        """
        self.ee, self.goal, self.joint_positions = ee_in_base, relative(goal, base_pose), joints
        self.velocity, self.rotation = catch_up(ee_in_base, planned, base_pose, HORIZON)


def _closeness(state: ObservedState, band: int) -> Any:
    """Return 1 at the base and 0 where nothing is in range, shape (n, beams)."""
    assert state.ranges is not None
    return 1.0 - state.ranges[:, band] / SCAN_RANGE


@dataclass(frozen=True)
class ObservationTerm:
    """A named part of an observation."""

    size: int | Callable[[Robot], int]  # count of numbers, or a function of the robot
    unit: str  # their unit
    scale: tuple[float, ...]  # factors for about unit range, shape (size,) or one for all
    values: Callable[[ObservedState], Any]  # computes them, shape (n, size)

    def width(self, robot: Robot) -> int:
        """Return the count of numbers for a robot."""
        return self.size if isinstance(self.size, int) else self.size(robot)


# Poses and velocities are in the current base frame. An EE at 0.1 m/s and 0.1 rad/s turns by a
# quaternion of about 0.005 in `HORIZON`.
TERMS = {
    "ee_position": ObservationTerm(3, "m", (1.0,), lambda state: state.ee[:, :3]),
    "ee_orientation": ObservationTerm(4, QUATERNION, (1.0,), lambda state: state.ee[:, 3:]),
    "planned_velocity": ObservationTerm(3, "m/s", (5.0,), lambda state: state.velocity),
    "planned_rotation": ObservationTerm(
        4,
        f"{QUATERNION}, over {HORIZON:g} s",
        (20.0, 20.0, 20.0, 1.0),
        lambda state: state.rotation,
    ),
    "goal_position": ObservationTerm(3, "m", (0.5,), lambda state: state.goal[:, :3]),
    "goal_orientation": ObservationTerm(4, QUATERNION, (1.0,), lambda state: state.goal[:, 3:]),
    "joint_positions": ObservationTerm(
        lambda robot: len(robot.arm), "rad or m", (0.5,), lambda state: state.joint_positions
    ),
    "previous_command": ObservationTerm(
        lambda robot: command_size(robot.base), "", (1.0,), lambda state: state.previous_command
    ),
    "planned_ahead": ObservationTerm(3 * len(AHEAD), "m", (0.5,), lambda state: state.ahead),
    "planned_base": ObservationTerm(
        3, "m, yaw in rad", (3.0, 3.0, 2.0), lambda state: state.planned_base
    ),
    "scan_low": ObservationTerm(SCAN_BEAMS, _CLOSENESS, (1.0,), lambda state: _closeness(state, 0)),
    "scan_high": ObservationTerm(
        SCAN_BEAMS, _CLOSENESS, (1.0,), lambda state: _closeness(state, 1)
    ),
}

SCAN_TERMS = {"scan_low", "scan_high"}  # terms that need a scan

SURROUNDINGS = SCAN_TERMS | {"planned_base"}
"""Terms that are 0 where nothing stands around the robot."""

OBSERVATION = tuple(TERMS)[:7]  # terms of policies by default, in this order

ACTION = "base_velocity"
"""Name of the action: velocity in the base frame, each number in [-1, 1], as a fraction of its
limit."""


def observe(state: ObservedState, terms: Sequence[str] = OBSERVATION) -> Array:
    """Return the observation of n robots, shape (n, d); `terms` are names in `TERMS`."""
    if not terms:
        return np.empty((len(state.ee), 0))
    return np.concatenate([TERMS[name].values(state) for name in terms], axis=1)


def size(robot: Robot, terms: Sequence[str] = OBSERVATION) -> int:
    """Return the count of numbers in an observation of a robot."""
    return sum(TERMS[name].width(robot) for name in terms)


def scale(robot: Robot, terms: Sequence[str] = OBSERVATION) -> Array:
    """Return factors that bring each number of an observation to about unit range, shape (d,)."""
    factors = [np.resize(TERMS[name].scale, TERMS[name].width(robot)) for name in terms]
    return np.concatenate(factors)


def surroundings_columns(robot: Robot, terms: Sequence[str]) -> list[int]:
    """Return the columns of the terms `SURROUNDINGS` in an observation."""
    flags = [[name in SURROUNDINGS] * TERMS[name].width(robot) for name in terms]
    return np.flatnonzero(np.concatenate(flags)).tolist()


def scaled(observation: Array, factors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return observations as the input of a network, shape (n, d)."""
    return np.minimum(np.maximum(observation.astype(np.float32) * factors, -CLIP), CLIP)


def describe_observation(robot: Robot, terms: Sequence[str]) -> tuple[TermInfo, ...]:
    """Return the description of observation terms for a robot."""
    joints = tuple(joint.name for joint in robot.arm)
    return tuple(
        TermInfo(name, len(joints), "joint", TERMS[name].unit, joints)
        if name == "joint_positions"
        else TermInfo(name, TERMS[name].width(robot), robot.base.frame, TERMS[name].unit)
        for name in terms
    )


def describe_action(robot: Robot) -> TermInfo:
    """Return the description of the actions for a robot."""
    base = robot.base
    linear = ("forward", "left")[: command_size(base) - 1]
    scale = (*(base.max_velocity for _ in linear), base.max_rotation)
    return TermInfo(ACTION, len(scale), base.frame, "m/s, turn in rad/s", (*linear, "turn"), scale)


def check_terms(names: object, where: str) -> tuple[str, ...]:
    """Return the names of observation terms.

    Raises:
        KinfeasError: If they are no list, or a term is unknown or there twice.
    """
    terms = ", ".join(TERMS)
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise KinfeasError(f"{where} must be a list of names, not {reprlib.repr(names)}")
    if not names or not set(names) <= TERMS.keys() or len(set(names)) < len(names):
        raise KinfeasError(f"{where} must have some of {terms}, each once, not {list(names)}")
    return tuple(names)
