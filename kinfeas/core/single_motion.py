"""Motion generators written for one motion, and their conversion to n motions."""

import copy
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ParamSpec, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import MotionGenerator, Rngs, State, TwistAndState, WholeBodyPath
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array

Parameters = ParamSpec("Parameters")


class SingleMotion(Protocol):
    """EE motion toward a target, for one motion.

    The state holds everything that changes, because all motions of a batch share the object. It is
    a dict of numbers and arrays with constant shapes.
    """

    def start(
        self, ee_pose: Array, target_pose: Array, rng: np.random.Generator
    ) -> Mapping[str, ArrayLike]:
        """Return the state of a motion that starts at `ee_pose`, shape (7,)."""

    def goal_pose(self, state: dict[str, Any], target_pose: Array) -> Array:
        """Return the world pose at which the motion ends, shape (7,)."""

    def twist(
        self, state: dict[str, Any], ee_pose: Array, target_pose: Array, dt: float
    ) -> tuple[Array, Mapping[str, ArrayLike]]:
        """Return the world twist for the next `dt` seconds, shape (6,), and the next state."""


def batched(single: Callable[Parameters, SingleMotion]) -> Callable[Parameters, MotionGenerator]:
    """Return the motion generator for n motions that runs the class `single` row by row.

    A class decorator; the result is a class of the same name, documentation and constructor::

        @batched
        class Hover:
            def __init__(self, *, height: float = 0.1) -> None: ...
            def start(self, ee_pose, target_pose, rng): ...  # (7,), (7,) -> dict
            def goal_pose(self, state, target_pose): ...  # -> (7,)
            def twist(self, state, ee_pose, target_pose, dt): ...  # -> (6,), dict

    The optional methods of `kinfeas.core.motion` are for one motion as well. Examples are
    `finished(self, state, target_pose)`, which returns whether it is at the end of a path of its
    own, and `replan(self, state, ee_pose, target_pose, solids)`, whose solids have one row. The
    class gets its own copy of every array and may write into it. Numbers in the state become
    float64. Each row costs a Python call; write generators for large batches with arrays.
    """
    if not isinstance(single, type):
        raise KinfeasError(f"batched takes a class, not {single!r}")

    # Composition, because self.goal_pose inside `single` is the one for one motion.
    @functools.wraps(single.__init__)  # type: ignore[misc]  # `single` is a class
    def __init__(self: RowByRow, *args: Any, **kwargs: Any) -> None:  # noqa: N807  a constructor
        self.single = single(*args, **kwargs)

    members = {name: getattr(single, name) for name in ("__doc__", "__module__", "__qualname__")}
    members |= {"__init__": __init__, "__signature__": inspect.signature(single)}
    for optional in (_finished, _base_pose, _replan, _follow, _robot_ahead, _ahead):
        name = optional.__name__.removeprefix("_")
        if callable(getattr(single, name, None)):
            members[name] = optional
    made = type(single.__name__, (RowByRow,), members)
    return cast("Callable[Parameters, MotionGenerator]", made)


class RowByRow:
    """A motion generator that loops over rows; `batched` adds the constructor.

    Attributes:
        single: The generator for one motion.
    """

    single: SingleMotion

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return the state of n motions; shapes (n, 7), (n, 7), n. It has no keys if n is 0."""
        rows = zip(ee_pose, target_pose, rngs, strict=True)
        states = [self.single.start(ee.copy(), target.copy(), rng) for ee, target, rng in rows]
        return _stacked(states)

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return _rows(_each(self, "goal_pose", state, target_pose), 7)

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist, shape (n, 6), and the next state."""
        answers = _each(self, "twist", state, ee_pose, target_pose, dt.tolist())
        if not answers:
            return np.zeros((0, 6)), dict(state)
        return np.array([twist for twist, _ in answers], float), _stacked([s for _, s in answers])


def _stacked(states: list[Mapping[str, ArrayLike]]) -> State:
    """Return the states of all motions, whose keys and shapes are equal, as one."""
    if any(state.keys() != states[0].keys() for state in states):
        raise KinfeasError("states must have equal keys for all motions")
    return {
        key: np.stack([np.asarray(state[key], dtype=np.float64) for state in states])
        for key in (states[0] if states else ())
    }


def _finished(self: RowByRow, state: State, target_pose: Array) -> NDArray[np.bool_]:
    ends = _each(self, "finished", state, target_pose)
    return np.array(ends) if ends else np.zeros(0, dtype=np.bool_)


def _base_pose(self: RowByRow, state: State, target_pose: Array) -> Array:
    return _rows(_each(self, "base_pose", state, target_pose), 7)


def _replan(
    self: RowByRow, state: State, ee_pose: Array, target_pose: Array, solids: Solids
) -> State:
    row_solids = [solids.of(np.array([row])) for row in range(len(ee_pose))]
    return _stacked(_each(self, "replan", state, ee_pose, target_pose, row_solids))


def _follow(
    self: RowByRow,
    state: State,
    ee_pose: Array,
    target_pose: Array,
    paths: Sequence[WholeBodyPath],
) -> tuple[State, Array]:
    states, waypoints = zip(*_each(self, "follow", state, ee_pose, target_pose, paths), strict=True)
    return _stacked([*states]), np.stack(waypoints)


def _robot_ahead(self: RowByRow, state: State, waypoints: Array, seconds: Array) -> Array:
    repeated = [seconds] * len(waypoints)
    return _rows(
        _each(self, "robot_ahead", state, waypoints, repeated), len(seconds), *waypoints.shape[2:]
    )


def _ahead(
    self: RowByRow, state: State, ee_pose: Array, target_pose: Array, distances: Array
) -> Array:
    repeated = [distances] * len(ee_pose)
    return _rows(_each(self, "ahead", state, ee_pose, target_pose, repeated), len(distances), 7)


def _each(self: RowByRow, name: str, state: State, *arguments: Iterable[Any]) -> list[Any]:
    """Return a method's result for each motion, called with that row of state and arguments."""
    method = getattr(self.single, name)
    return [
        method({key: values[i].copy() for key, values in state.items()}, *map(copy.copy, row))
        for i, row in enumerate(zip(*arguments, strict=True))
    ]


def _rows(values: list[Array], *shape: int) -> Array:
    return np.stack(values) if values else np.zeros((0, *shape))
