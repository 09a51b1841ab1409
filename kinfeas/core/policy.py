"""Protocols of policies, which command the base, and of filters, which change commands."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class PolicyInput:
    """Input of a policy for n robots.

    Attributes:
        observation: Observation terms that the policy names, shape (n, d).
        base_pose: World pose of the base, shape (n, 7).
        ee_pose: Achieved world pose of the EE, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        desired: Desired world pose of the EE now, shape (n, 7).
        planned: Desired world pose in `observation.HORIZON` seconds, shape (n, 7), at the time
            scale of the execution; the observation shows the motion at full speed.
        demonstrated_base: World pose of the base in the demonstration, shape (n, 7); NaN where the
            motion has none.
        planned_base: World pose of the base on a whole-body path, `LEAD` seconds ahead, shape
            (n, 7); NaN where the motion has none.
    """

    observation: Array
    base_pose: Array
    ee_pose: Array
    joint_positions: Array
    desired: Array
    planned: Array
    demonstrated_base: Array
    planned_base: Array


@dataclass(frozen=True)
class TermInfo:
    """Description of a term in a policy's file.

    Attributes:
        name: Name of the term.
        size: Count of numbers.
        frame: Frame of the numbers; `joint` for joint positions.
        unit: Their unit.
        entries: Name of each number, for terms that are no vector.
        scale: Value of each number at an action of 1.
    """

    name: str
    size: int
    frame: str
    unit: str
    entries: tuple[str, ...] = ()
    scale: tuple[float, ...] = ()


class Policy(Protocol):
    """Commands the base.

    The attributes `observation_terms` and `action_terms`, where there are any, name other terms
    than the default ones.
    """

    def act(self, policy_input: PolicyInput) -> Array:
        """Return the action terms in [-1, 1], shape (n, a): at least the base's command."""
        ...


@runtime_checkable
class RecurrentPolicy(Policy, Protocol):
    """A policy with a state of its own."""

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Begin new episodes in `rows`, shape (m,), of the `kinfeas.control.loop.Loop`."""
        ...


class CommandFilter(Protocol):
    """Changes base commands before they are sent.

    The attribute `period` of its loop is what the step is about to carry out.
    """

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Begin new episodes, as a `RecurrentPolicy`; raise KinfeasError for an unfit loop."""
        ...

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1] in place of `command`; both (n, 3) or (n, 2)."""
        ...
