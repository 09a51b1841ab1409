"""Policies, which command the base, and what they observe."""

from dataclasses import dataclass
from typing import Protocol

from kinfeas.core.backend import ObstacleSensor
from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class Observation:
    """Observation of n robots.

    Attributes:
        values: Observation terms that the policy names, shape (n, d).
        base_pose: World pose of the base, shape (n, 7).
        ee_pose: Achieved world pose of the EE, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        desired: Desired world pose of the EE now, shape (n, 7).
        planned: Desired world pose in `observation.HORIZON` seconds, shape (n, 7), at the time
            scale of the execution; the terms in `values` are for motions at full speed.
        demonstrated_base: World pose of the base in the demonstration, shape (n, 7); NaN where the
            motion has none.
        planned_base: World pose of the base on a whole-body path, `LEAD` seconds ahead, shape
            (n, 7); NaN where the motion has none.
        dt: Control period, seconds.
        obstacles: Measures distances to obstacles, where the backend can.
    """

    values: Array
    base_pose: Array
    ee_pose: Array
    joint_positions: Array
    desired: Array
    planned: Array
    demonstrated_base: Array
    planned_base: Array
    dt: float
    obstacles: ObstacleSensor | None = None


@dataclass(frozen=True)
class TermInfo:
    """Description of a term in a policy's file."""

    name: str  # name of the term
    size: int  # count of numbers
    frame: str  # frame of the numbers; `joint` for joint positions
    unit: str  # their unit
    entries: tuple[str, ...] = ()  # name of each number, for terms that are no vector
    scale: tuple[float, ...] = ()  # value of each number at an action of 1


class Policy(Protocol):
    """Commands the base.

    The attribute `observation_terms`, if there is one, names other terms than the default ones.
    `filters` names command filters that are applied before the others, unless targets are a stream.
    A policy with a state of its own has `reset(rows, n)`: begin new episodes in `rows`, shape (m,),
    of n robots.
    """

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
