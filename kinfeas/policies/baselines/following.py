"""Baselines that follow: the base moves with the EE, or along a known base motion."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinfeas.config.recipes import load_section
from kinfeas.control.observation import HORIZON
from kinfeas.core.kernels import compiled
from kinfeas.core.policy import Observation
from kinfeas.core.pose_kernels import TWIST, clipped, heading, wrapped
from kinfeas.core.spatial import Array
from kinfeas.kinematics.drive import action_toward, command_size, write_action_toward
from kinfeas.robots.robot import Base, Robot

_MIN_SPEED = 0.05
"""Speed, m/s, at which the base continues while the EE rests."""

_LEVER = 0.5
"""Metres of translation that one radian of rotation counts for."""

_THERE = 0.05
"""Distance, metres, at which a differential base turns to the final heading."""


@dataclass(frozen=True)
class FollowEe:
    """Copies the planar velocity of the EE, its mean over `HORIZON` seconds, without rotation.

    Attributes:
        base: Drive and velocity limits.
        feedback: Whether the velocity is measured from the achieved EE position, so that the base
            also reduces the tracking error, instead of the desired one.
        filters: Command filters before the others, see `Policy`.
    """

    base: Base
    feedback: bool = False
    filters: tuple[str, ...] = ()

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        start = observation.ee_pose if self.feedback else observation.desired
        velocity = (observation.planned[:, :2] - start[:, :2]) / HORIZON
        return action_toward(self.base, observation.base_pose, velocity, HORIZON)


def follow_ee(robot: Robot) -> FollowEe:
    """Return the baseline that copies the planar velocity of the desired EE pose."""
    return FollowEe(robot.base)


def follow_ee_feedback(robot: Robot) -> FollowEe:
    """Return the baseline that copies the planar velocity from the achieved to the planned pose."""
    return FollowEe(robot.base, feedback=True)


@dataclass(frozen=True)
class Stationary:
    """Leaves the base at rest, so that the arm moves alone."""

    base: Base

    def act(self, observation: Observation) -> Array:
        """Return zero commands, shape (n, 3) or (n, 2)."""
        return np.zeros((len(observation.base_pose), command_size(self.base)))


def stationary(robot: Robot) -> Stationary:
    """Return the baseline that leaves the base at rest."""
    return Stationary(robot.base)


@dataclass(frozen=True)
class BaselineConfig:
    """Settings for a robot: metres by which its base drives ahead of the demonstrator's."""

    forward_shift: float = 0.0


@dataclass(frozen=True)
class FollowBase:
    """Drives to the base pose of a demonstration, or of a whole-body path.

    Without one, it copies the EE's velocity.

    It keeps the speed of the EE: at full speed the base would leave the EE behind on its way to
    the start of the demonstration. An omnidirectional base drives and turns at the same time; a
    differential one drives to the position first and turns there.

    Attributes:
        base: Drive and velocity limits.
        forward_shift: Distance of the target ahead of that base pose, metres.
        source: Field of `Observation` that has the base pose.
    """

    base: Base
    forward_shift: float = 0.0
    source: Literal["demonstrated_base", "planned_base"] = "demonstrated_base"

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        base, pose = self.base, observation.base_pose
        target: Array = getattr(observation, self.source)
        motion = observation.planned[:, :3] - observation.desired[:, :3]
        rules = np.array([base.max_velocity, base.max_rotation, self.forward_shift])
        like = TWIST[: command_size(base)]
        return _follow_base(target, pose, motion, rules, like)


@compiled(["void(f8[:], f8[:], f8[:], f8[:], f8[:], f8[:])"], "(p),(p),(m),(r),(a)->(a)")
def _follow_base(
    target: Array, pose: Array, motion: Array, rules: Array, like: Array, out: Array
) -> None:
    """Write the action toward a target base pose at the EE's speed; without one, copy its velocity.

    `motion` is the displacement of the EE in `HORIZON` seconds; `rules` are the velocity limits of
    the base and its distance ahead of the target. `like` has the size of the action.
    """
    max_velocity, max_rotation, shift = rules
    now, x, y = heading(pose), motion[0] / HORIZON, motion[1] / HORIZON
    turn, arrived = 0.0, False
    if not math.isnan(target.sum()):
        angle = heading(target)
        offset_x = target[0] + shift * math.cos(angle) - pose[0]
        offset_y = target[1] + shift * math.sin(angle) - pose[1]
        turn, distance = wrapped(angle - now), math.sqrt(offset_x * offset_x + offset_y * offset_y)
        step = max(math.sqrt((motion * motion).sum()), _MIN_SPEED * HORIZON)
        rate = step / max(distance, _LEVER * abs(turn), step) / HORIZON
        x, y, turn, arrived = offset_x * rate, offset_y * rate, turn * rate, distance <= _THERE
    write_action_toward(pose, (x, y), rules, HORIZON, out)
    if len(out) == 3:
        out[2] = clipped(turn / max_rotation)
    elif arrived:
        forward = math.cos(now) * x + math.sin(now) * y
        out[0], out[1] = clipped(forward / max_velocity), clipped(turn / max_rotation)


def demonstrated_base(robot: Robot) -> FollowBase:
    """Return the baseline that drives to the base pose of the demonstration."""
    settings = load_section(BaselineConfig, "baselines", robot.folder)
    return FollowBase(robot.base, settings.forward_shift)


def planned_base(robot: Robot) -> FollowBase:
    """Return the baseline that drives to the base pose of the whole-body path."""
    return FollowBase(robot.base, source="planned_base")
