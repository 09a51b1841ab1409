"""The base goes where the demonstrator's base was, as far as the motion knows of it."""

from dataclasses import dataclass

import numpy as np

from kinfeas.config.recipes import load_section
from kinfeas.control.drive import action_toward
from kinfeas.control.observation import HORIZON
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, wrap, yaw
from kinfeas.policies.baselines.follow_ee import FollowEe
from kinfeas.robots.robot import Base, Robot

_SLOWEST = 0.05
"""Speed, m/s, at which the base goes on while the EE stands."""

_LEVER = 0.5
"""Metres of way that one radian of turning counts for."""

_THERE = 0.05
"""Metres from where it should be at which a differential base turns to its heading instead."""


@dataclass(frozen=True)
class BaselineConfig:
    """Settings of baselines: the section `baselines` of a robot.

    Attributes:
        forward_shift: How far ahead of the demonstrator's base the robot's stands, metres.
    """

    forward_shift: float = 0.0


@dataclass(frozen=True)
class DemonstratedBase:
    """Drives to the demonstrated base pose; where there is none, it does as `FollowEe`.

    It goes at the pace of the EE: while the hand is still on its way to where the demonstration
    began, a base that went ahead at its full speed would leave the hand behind. An omnidirectional
    base drives and turns in step; a differential one drives to the place and turns there.

    Attributes:
        base: Drive and velocity limits.
        forward_shift: How far ahead of the demonstrated base it aims, metres.
    """

    base: Base
    forward_shift: float = 0.0

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        known = ~np.isnan(policy_input.demonstrated_base).any(axis=1, keepdims=True)
        # Numbers that are used nowhere take the place of those that are missing.
        wanted = np.where(known, policy_input.demonstrated_base, policy_input.base_pose)
        follow = FollowEe(self.base).act(policy_input)
        return np.where(known, self._toward(policy_input, wanted), follow)

    def _toward(self, policy_input: PolicyInput, wanted: Array) -> Array:
        base, pose, heading = self.base, policy_input.base_pose, yaw(wanted)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1) * self.forward_shift
        way, turn = wanted[:, :2] + ahead - pose[:, :2], wrap(heading - yaw(pose))
        execution = _length(policy_input.planned[:, :3] - policy_input.desired[:, :3])
        execution = np.maximum(execution, _SLOWEST * HORIZON)
        share = execution / np.maximum(np.maximum(_length(way), _LEVER * np.abs(turn)), execution)
        velocity = way * share[:, None] / HORIZON
        rotation = turn * share / HORIZON / base.max_rotation
        action = action_toward(base, pose, velocity, HORIZON)
        if base.drive == "omnidirectional":
            action[:, -1] = rotation
        else:
            forward = np.cos(yaw(pose)) * velocity[:, 0] + np.sin(yaw(pose)) * velocity[:, 1]
            turning = np.stack([forward / base.max_velocity, rotation], axis=1)
            action = np.where((_length(way) <= _THERE)[:, None], turning, action)
        return np.clip(action, -1.0, 1.0)


def _length(vectors: Array) -> Array:
    return np.sqrt((vectors * vectors).sum(axis=1))


def demonstrated_base(robot: Robot) -> DemonstratedBase:
    """Return the policy for a robot with the shift of its section `baselines`."""
    known = load_section(BaselineConfig, "baselines", robot.name)
    return DemonstratedBase(robot.base, known.forward_shift)
