"""Protocol of motion generators, which plugins implement, and rows of their states."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array

State = dict[str, Array]
Rows = NDArray[np.intp]  # indices along the leading axis
Rngs = Sequence[np.random.Generator]  # one source of randomness for each motion
TwistAndState = tuple[Array, State]  # world twists, shape (n, 6), and the state after them


class MotionGenerator(Protocol):
    """EE motion toward a target, for n motions at once.

    Pure: the state is an argument and a return value, a dict of arrays with leading axis n, so that
    callers can restart single motions and preview steps. States may share arrays; callers write
    into copies. The target is an argument of every call, since it may move; values that are fixed
    at the start belong in the state. A generator may be called several times a step, is built from
    keyword parameters, and does not depend on the robot or the frame that it moves.
    """

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return the state of n motions that begin at `ee_pose`, without shared memory.

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7).
            target_pose: Goal of the EE, or pose of the grasped object, shape (n, 7).
            rngs: One source of randomness for each motion, n of them.
        """

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7), for current targets."""

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: Current desired world pose, shape (n, 7).
            target_pose: Current poses of the targets, shape (n, 7).
            dt: Duration of each motion's step in seconds, shape (n,).
        """


@runtime_checkable
class FollowsPath(Protocol):
    """A motion generator whose motions have a path or timing of their own.

    They end at the end of the path, near `goal_pose`. A motion of any other generator ends as soon
    as it is near `goal_pose`.
    """

    def finished(self, state: State, target_pose: Array) -> NDArray[np.bool_]:
        """Return whether n motions are at the end of their paths, shape (n,); targets (n, 7)."""


@runtime_checkable
class Demonstrated(Protocol):
    """A motion generator with a demonstrated motion of the base."""

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses of the base in the demonstration now, shape (n, 7).

        Rows without a demonstration are NaN.
        """


@runtime_checkable
class AvoidsSolids(Protocol):
    """A motion generator that plans around solids."""

    def replan(self, state: State, ee_pose: Array, target_pose: Array, solids: Solids) -> State:
        """Return the state of n motions that avoid the solids at their present positions.

        Called after `start` and, where solids move, about once a second. `solids` are those around
        each motion, n rows; other arguments as in `MotionGenerator.twist`.
        """


WAYPOINTS = 64
"""Points that are kept of a whole-body path."""


@dataclass(frozen=True)
class WholeBodyPath:
    """A motion of the whole robot."""

    ee: Array  # world poses of the EE, shape (k, 7)
    # x, y and unwrapped yaw of the base, then arm joints, shape (k, 3 + j), metres and radians
    robot: Array
    seconds: Array  # shortest times in which base and arm get from row to row, shape (k - 1,)


@runtime_checkable
class FollowsWholeBodyPath(Protocol):
    """A motion generator that follows motions which a planner finds for base and arm."""

    def follow(
        self, state: State, ee_pose: Array, target_pose: Array, paths: Sequence[WholeBodyPath]
    ) -> tuple[State, Array]:
        """Return the state of n motions along their paths.

        The second value has `WAYPOINTS` configurations of each path, shape (n, 64, 3 + j), for
        `robot_ahead`. Called before `replan` of `AvoidsSolids`, which keeps these motions.
        There is a path for each motion, from about `ee_pose` to the target; other arguments as in
        `MotionGenerator.twist`.
        """

    def robot_ahead(self, state: State, waypoints: Array, seconds: Array) -> Array:
        """Return base and joints some seconds ahead on the paths, shape (n, s, 3 + j), or NaN.

        Args:
            state: State of n motions.
            waypoints: From `follow`, shape (n, 64, 3 + j); NaN for motions without a path.
            seconds: From now on, shape (s,).
        """


@runtime_checkable
class LooksAhead(Protocol):
    """A motion generator whose paths can be read in advance."""

    def ahead(self, state: State, ee_pose: Array, target_pose: Array, distances: Array) -> Array:
        """Return the poses that lie ahead on the motions, up to their ends, shape (n, d, 7).

        `distances` are path lengths of the position from `ee_pose` on, shape (d,), metres; other
        arguments as in `MotionGenerator.twist`.
        """


OPTIONAL = ("finished", "base_pose", "replan", "follow", "robot_ahead", "ahead")
"""Names of the optional methods of motion generators."""


def with_rows(array: NDArray[Any], rows: Rows | None, values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of `array` with `values` in `rows`; `values` themselves if `rows` is None."""
    if rows is None:
        return values
    changed = array.copy()
    changed[rows] = values
    return changed


def of_rows(state: State, rows: Rows) -> State:
    """Return the state of `rows`."""
    return {key: values[rows] for key, values in state.items()}


def merged(state: State, rows: Rows, values: State, n: int) -> State:
    """Return the state of n rows with `values` in `rows`; other rows of an empty state are zero.

    `CheckedMotion` checks that keys, types and shapes of both are equal.
    """
    if len(rows) == n:
        return values
    return {
        key: with_rows(state.get(key, np.zeros((n, *new.shape[1:]), new.dtype)), rows, new)
        for key, new in values.items()
    }
