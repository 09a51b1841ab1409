"""Observation and action terms of policies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.drive import action_size
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import TermInfo
from kinfeas.core.spatial import IDENTITY, Array, integrate, relative, twist_between
from kinfeas.robots.robot import Robot

HORIZON = 0.1
"""Seconds of planned motion that an observation shows, at any control rate."""

CLIP = 3.0
"""Bound of a scaled number: an EE far from its path would dominate all others."""

QUATERNION = "quaternion xyzw, w >= 0"


class Seen:
    """State of n robots in their base frames, from which the terms are computed.

    Attributes:
        ee: Achieved EE pose, shape (n, 7).
        goal: Pose at which the EE's motion ends, shape (n, 7).
        velocity: Linear velocity from the achieved to the planned EE pose, shape (n, 3), m/s. It
            contains the tracking error.
        rotation: Rotation change over `HORIZON` seconds, shape (n, 4).
        joint_positions: Arm joints, continuous ones in (-pi, pi], shape (n, j).
    """

    def __init__(
        self, base_pose: Array, ee_in_base: Array, planned: Array, goal: Array, joints: Array
    ) -> None:
        """Compute the relative poses.

        `base_pose`, `planned` (the EE's in `HORIZON` seconds) and `goal` are world poses, shape
        (n, 7); `ee_in_base` is achieved. Joints have shape (n, j).
        """
        self.ee, self.goal, self.joint_positions = ee_in_base, relative(goal, base_pose), joints
        catch_up = twist_between(ee_in_base, relative(planned, base_pose), HORIZON)
        self.velocity = catch_up[:, :3]
        self.rotation = integrate(IDENTITY, catch_up, HORIZON)[:, 3:]


@dataclass(frozen=True)
class ObservationTerm:
    """A named part of an observation.

    Attributes:
        size: Count of numbers; 0 for one number for each arm joint.
        unit: Their unit.
        scale: Factors that bring each number to about unit range, shape (size,) or one for all.
        values: Computes them, shape (n, size).
    """

    size: int
    unit: str
    scale: tuple[float, ...]
    values: Callable[[Seen], Array]

    def width(self, robot: Robot) -> int:
        """Return the count of numbers for a robot."""
        return self.size or len(robot.arm)


# An EE at 0.1 m/s and 0.1 rad/s turns by a quaternion of about 0.005 in `HORIZON`.
TERMS = {
    "ee_position": ObservationTerm(3, "m", (1.0,), lambda seen: seen.ee[:, :3]),
    "ee_orientation": ObservationTerm(4, QUATERNION, (1.0,), lambda seen: seen.ee[:, 3:]),
    "planned_velocity": ObservationTerm(3, "m/s", (5.0,), lambda seen: seen.velocity),
    "planned_rotation": ObservationTerm(
        4, f"{QUATERNION}, over {HORIZON:g} s", (20.0, 20.0, 20.0, 1.0), lambda seen: seen.rotation
    ),
    "goal_position": ObservationTerm(3, "m", (0.5,), lambda seen: seen.goal[:, :3]),
    "goal_orientation": ObservationTerm(4, QUATERNION, (1.0,), lambda seen: seen.goal[:, 3:]),
    "joint_positions": ObservationTerm(0, "rad or m", (0.5,), lambda seen: seen.joint_positions),
}
"""Observation terms by name; poses and velocities are in the current base frame."""

OBSERVATION = tuple(TERMS)
"""Terms of the shipped policies, in this order."""

ACTION = ("base_velocity",)
"""Action terms: the base velocity in the base frame, as shares of its limits in [-1, 1]."""


def observe(seen: Seen, terms: Sequence[str] = OBSERVATION) -> Array:
    """Return the observation of n robots, shape (n, d); `terms` are names in `TERMS`."""
    return np.concatenate([TERMS[name].values(seen) for name in terms], axis=1)


def size(robot: Robot, terms: Sequence[str] = OBSERVATION) -> int:
    """Return the count of numbers in an observation of a robot."""
    return sum(TERMS[name].width(robot) for name in terms)


def scale(robot: Robot, terms: Sequence[str] = OBSERVATION) -> Array:
    """Return factors that bring each number of an observation to about unit range, shape (d,)."""
    each = [np.resize(TERMS[name].scale, TERMS[name].width(robot)) for name in terms]
    return np.concatenate(each)


def scaled(observation: Array, factors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return observations as the input of a network, shape (n, d)."""
    return np.clip(observation.astype(np.float32) * factors, -CLIP, CLIP)


def describe_observation(robot: Robot, terms: Sequence[str]) -> tuple[TermInfo, ...]:
    """Return the description of observation terms for a robot."""
    joints = tuple(joint.name for joint in robot.arm)
    return tuple(
        TermInfo(name, len(joints), "joint", TERMS[name].unit, joints)
        if name == "joint_positions"
        else TermInfo(name, TERMS[name].size, robot.base.frame, TERMS[name].unit)
        for name in terms
    )


def describe_action(robot: Robot) -> tuple[TermInfo, ...]:
    """Return the description of the action terms for a robot."""
    base = robot.base
    linear = ("forward", "left")[: action_size(base) - 1]
    scale = (*(base.max_velocity for _ in linear), base.max_rotation)
    entries = (*linear, "turn")
    unit = "m/s, turn in rad/s"
    return (TermInfo(ACTION[0], len(entries), base.frame, unit, entries, scale),)


def check_terms(found: Sequence[TermInfo], known: Sequence[str], key: str) -> tuple[str, ...]:
    """Return the names of the terms under `key` of a policy's file, all of them known."""
    for term in found:
        if term.name not in known:
            raise KinfeasError(f"{key}: unknown term {term.name!r}; known are {', '.join(known)}")
    return tuple(term.name for term in found)
