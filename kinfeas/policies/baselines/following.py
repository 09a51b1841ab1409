"""Baselines that follow: the base moves with the EE, or along a known base motion."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinfeas.config.recipes import load_section
from kinfeas.control.drive import action_toward, command_size
from kinfeas.control.observation import HORIZON
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, wrap, yaw
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
        feedback: Whether the velocity starts at the achieved EE position, so that the base also
            reduces the tracking error, or at the desired one.
    """

    base: Base
    feedback: bool = False

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        start = policy_input.ee_pose if self.feedback else policy_input.desired
        velocity = (policy_input.planned[:, :2] - start[:, :2]) / HORIZON
        return action_toward(self.base, policy_input.base_pose, velocity, HORIZON)


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

    def act(self, policy_input: PolicyInput) -> Array:
        """Return zero commands, shape (n, 3) or (n, 2)."""
        return np.zeros((len(policy_input.base_pose), command_size(self.base)))


def stationary(robot: Robot) -> Stationary:
    """Return the baseline that leaves the base at rest."""
    return Stationary(robot.base)


@dataclass(frozen=True)
class BaselineConfig:
    """Settings for a robot: metres by which its base is ahead of the demonstrator's."""

    forward_shift: float = 0.0


@dataclass(frozen=True)
class FollowBase:
    """Drives to the base pose of a demonstration, or of a whole-body path.

    Without one, it copies the EE's velocity.

    It keeps the speed of the EE: a base at full speed would leave an EE behind that is still on
    its way to the start of the demonstration. An omnidirectional base drives and turns at once; a
    differential one drives there and turns then.

    Attributes:
        base: Drive and velocity limits.
        forward_shift: Distance ahead of that base pose, metres.
        source: Which base pose.
    """

    base: Base
    forward_shift: float = 0.0
    source: Literal["demonstrated_base", "planned_base"] = "demonstrated_base"

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        base, pose = self.base, policy_input.base_pose
        wanted: Array = getattr(policy_input, self.source)
        known = ~np.isnan(wanted).any(axis=1, keepdims=True)
        # Any finite numbers take the place of missing ones; their result is not used.
        wanted = np.where(known, wanted, pose)
        heading, now = yaw(wanted), yaw(pose)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1) * self.forward_shift
        way, turn = wanted[:, :2] + ahead - pose[:, :2], wrap(heading - now)
        motion = policy_input.planned[:, :3] - policy_input.desired[:, :3]
        step, distance = np.maximum(_length(motion), _MIN_SPEED * HORIZON), _length(way)
        share = step / np.maximum(np.maximum(distance, _LEVER * np.abs(turn)), step)
        velocity = np.where(known, way * share[:, None], motion[:, :2]) / HORIZON
        rotation = turn * share / HORIZON / base.max_rotation
        action = action_toward(base, pose, velocity, HORIZON)
        if base.drive == "omnidirectional":
            action[:, -1:] = np.where(known, rotation[:, None], 0.0)
        else:
            forward = np.cos(now) * velocity[:, 0] + np.sin(now) * velocity[:, 1]
            turning = np.stack([forward / base.max_velocity, rotation], axis=1)
            action = np.where(known & (distance <= _THERE)[:, None], turning, action)
        return np.clip(action, -1.0, 1.0)


def _length(vectors: Array) -> Array:
    return np.sqrt((vectors * vectors).sum(axis=1))


def demonstrated_base(robot: Robot) -> FollowBase:
    """Return the baseline that drives to the base pose of the demonstration."""
    known = load_section(BaselineConfig, "baselines", robot.name)
    return FollowBase(robot.base, known.forward_shift)


def planned_base(robot: Robot) -> FollowBase:
    """Return the baseline that drives to the base pose of the whole-body path."""
    return FollowBase(robot.base, source="planned_base")
