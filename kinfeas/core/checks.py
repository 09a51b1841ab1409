"""Checks of the arrays, states and motion generators of plugins."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.motion import (
    OPTIONAL,
    WAYPOINTS,
    MotionGenerator,
    Rngs,
    State,
    TwistAndState,
    WholeBodyPath,
)
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import UNIT, Array, distance, integrate, twist_between

_COMPUTED = 1e-6  # largest deviation from 1 of the norm of a quaternion that is used as it is
MAX_TILT = 0.5
"""Largest tilt of a base, radians. Ramps and localisation tilt less. A quaternion wxyz, read as
xyzw, tilts an upright base of yaw a by pi - |a|."""

Layout = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]


def check_array(
    value: object,
    shape: tuple[int, ...],
    name: str,
    *,
    finite: bool = True,
    error: type[KinfeasError] = KinfeasError,
) -> None:
    """Raise an `error` whose message begins with `name` unless a value is an array of `shape`."""
    if not isinstance(value, np.ndarray):
        raise error(f"{name} is a {type(value).__name__}, not an array of shape {shape}")
    if value.shape != shape:
        raise error(f"{name} has shape {value.shape}, not {shape}")
    if value.dtype.kind not in "iuf" or value.dtype.char in "eg":  # Numba has no other floats
        raise error(f"{name} is an array of {value.dtype}")
    if finite and not np.isfinite(value).all():
        raise error(f"{name} is not finite")


def are_unit(poses: Array, tolerance: float = _COMPUTED) -> bool:
    """Return whether the quaternions of poses, shape (..., 7), have unit length."""
    deviation = np.abs(np.linalg.norm(poses[..., 3:], axis=-1) - 1.0).max(initial=0.0)
    return bool(deviation < tolerance)


def ee_poses(poses: ArrayLike, name: str) -> Array:
    """Return EE poses, shape (n, 7) with n at least 1, or raise an error.

    Quaternions are normalised.
    """
    try:
        array = np.atleast_2d(np.array(poses, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise KinfeasError(f"{name!r} must be numbers x y z qx qy qz qw: {error}") from error
    if poses is None or not array.size:
        raise KinfeasError(f"{name!r} has no poses")
    if array.ndim != 2 or array.shape[1] != 7:
        raise KinfeasError(f"{name!r} must be of shape (n, 7), not {array.shape}")
    if not (np.abs(array) <= FARTHEST).all() or not are_unit(array, UNIT):
        raise KinfeasError(f"{name!r} must be within {FARTHEST:g} m, with unit quaternions xyzw")
    array[:, 3:] /= np.linalg.norm(array[:, 3:], axis=1, keepdims=True)
    return array


def check_state(state: object, robots: int, joints: int, source: str) -> None:
    """Raise KinfeasError unless a backend or adapter returns a valid `RobotState`.

    Poses and joint positions must be finite, and bases upright. The message begins with `source`.
    """
    if not isinstance(state, RobotState):
        raise KinfeasError(f"{source} must return a RobotState, not a {type(state).__name__}")
    poses, arms = (robots, 7), (robots, joints)
    for name in ("base_pose", "ee_in_base", "localised"):
        pose = getattr(state, name)
        if pose is None and name != "base_pose":
            continue
        check_array(pose, poses, f"{source}: {name}")
        if not are_unit(pose, UNIT):
            raise KinfeasError(f"{source}: {name} has no unit quaternion xyzw")
    tilt = 2.0 * np.hypot(*state.base_pose[:, 3:5].T).max(initial=0.0)
    if tilt > MAX_TILT:
        text = f"leans by {tilt:.2g} rad, at most {MAX_TILT} is allowed; quaternions are xyzw"
        raise KinfeasError(f"{source}: base_pose {text}")
    check_array(state.joint_positions, arms, f"{source}: joint_positions")
    shapes = {"base_twist": (robots, 6), "joint_velocities": arms, "age": (robots,)}
    for name, shape in shapes.items():
        if (value := getattr(state, name)) is not None:
            check_array(value, shape, f"{source}: {name}", finite=False)
    if state.true_state is not None:
        check_state(state.true_state, robots, joints, f"{source}: true_state")


class ConformanceError(KinfeasError):
    """A violation of the contract of motion generators.

    Attributes:
        rule: Key of `testing.RULES`.
    """

    def __init__(self, message: str, rule: str = "form") -> None:
        super().__init__(message)
        self.rule = rule


class CheckedMotion:
    """A motion generator that checks the return values of another generator.

    Goals and twists are checked at each call; states and other values at the first call of each
    method after a start, or at each call with `every_step`. All states must have the keys, shapes
    and types of the first one, so that rows can be exchanged. Exceptions of the generator get a
    note with its `name`, by default its class.

    Attributes:
        avoids_solids: Whether it plans around solids.
        follows_whole_body: Whether it follows motions that are planned for base and arm.

    Raises:
        ConformanceError: From all methods, if a return value is invalid.
    """

    def __init__(
        self, generator: MotionGenerator, name: str = "", *, every_step: bool = False
    ) -> None:
        self.generator = generator
        self.subject = f"motion generator {name or type(generator).__name__}"
        self._optional = {method for method in OPTIONAL if hasattr(generator, method)}
        for method in self._optional:
            if not callable(getattr(generator, method)):
                raise self.error(f"has an attribute {method!r} that is no method; rename it")
        self.avoids_solids = "replan" in self._optional
        self.follows_whole_body = {"follow", "robot_ahead"} <= self._optional
        self._every_step, self._checked = every_step, set[str]()
        self._layout: Layout | None = None

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return the state of n >= 1 motions from poses, shape (n, 7) each, and n `rngs`."""
        state = self._call("start", ee_pose, target_pose, rngs)
        self._check_state("start", state, len(ee_pose))
        self._checked.clear()
        if not are_unit(self.goal_pose(state, target_pose)):
            raise self.error("returns a goal_pose without unit quaternion", "quaternions")
        return state

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        goal = self._call("goal_pose", state, target_pose)
        self._check_array("goal_pose", goal, (len(target_pose), 7))
        return goal

    def finished(self, state: State, target_pose: Array) -> NDArray[np.bool_]:
        """Return whether the motions are at the end of their paths, (n,); true without paths."""
        n = len(target_pose)
        if "finished" not in self._optional:
            return np.ones(n, dtype=np.bool_)
        finished = self._call("finished", state, target_pose)
        fits = isinstance(finished, np.ndarray) and finished.shape == (n,)
        if not fits or finished.dtype != np.bool_:
            raise self.error(f"must return booleans of shape ({n},) from finished")
        return finished

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        answer = self._call("twist", state, ee_pose, target_pose, dt)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise self.error("must return a pair from twist: the twist and the next state")
        self._check_array("twist", answer[0], (len(ee_pose), 6))
        if self._due("twist"):
            if self._layout is None and len(ee_pose):  # resumed without a start
                self._layout = _layout(state)
            self._check_state("twist", answer[1], len(ee_pose))
        return answer

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return the demonstrated base poses, shape (n, 7); NaN if there are none."""
        n = len(target_pose)
        if "base_pose" not in self._optional:
            return np.full((n, 7), np.nan)
        pose = self._call("base_pose", state, target_pose)
        if self._due("base_pose"):
            self._check_array("base_pose", pose, (n, 7), finite=False)
            demonstrated = pose[~np.isnan(pose).all(axis=1)]
            self._check_array("base_pose", demonstrated, demonstrated.shape)
        return pose

    def replan(self, state: State, ee_pose: Array, target_pose: Array, solids: Solids) -> State:
        """Return the state of motions that avoid solids; the same if the generator does not."""
        if not self.avoids_solids:
            return state
        state = self._call("replan", state, ee_pose, target_pose, solids)
        self._check_state("replan", state, len(ee_pose))
        return state

    def follow(
        self, state: State, ee_pose: Array, target_pose: Array, paths: Sequence[WholeBodyPath]
    ) -> tuple[State, Array]:
        """Return the state of motions along paths, and their waypoints, (n, 64, 3 + j)."""
        state, waypoints = self._call("follow", state, ee_pose, target_pose, paths)
        self._check_state("follow", state, len(ee_pose))
        shape = len(ee_pose), WAYPOINTS, paths[0].robot.shape[1]
        self._check_array("follow", waypoints, shape)
        return state, waypoints

    def robot_ahead(self, state: State, waypoints: Array, seconds: Array) -> Array:
        """Return base and joints some seconds ahead, shape (n, s, 3 + j), or NaN."""
        robot = self._call("robot_ahead", state, waypoints, seconds)
        if self._due("robot_ahead"):
            shape = len(waypoints), len(seconds), waypoints.shape[2]
            self._check_array("robot_ahead", robot, shape, finite=False)
        return robot

    def ahead(self, state: State, ee_pose: Array, target_pose: Array, distances: Array) -> Array:
        """Return the poses some metres ahead, (n, 7) and (d,) -> (n, d, 7), up to the goal.

        They lie on the straight line to the goal if the generator does not look ahead.
        """
        if "ahead" not in self._optional:
            goal = self.goal_pose(state, target_pose)
            metres = np.maximum(distance(ee_pose, goal)[0], 1e-9)[:, np.newaxis]
            twist = twist_between(ee_pose, goal, 1.0)[:, np.newaxis]
            return integrate(ee_pose[:, np.newaxis], twist, np.minimum(distances / metres, 1.0))
        poses = self._call("ahead", state, ee_pose, target_pose, distances)
        if self._due("ahead"):
            self._check_array("ahead", poses, (len(ee_pose), len(distances), 7))
        return poses

    def error(self, broken: str, rule: str = "form") -> ConformanceError:
        """Return an error whose subject is the generator."""
        return ConformanceError(f"{self.subject} {broken}", rule)

    def _call(self, method: str, *arguments: object) -> Any:
        with plugin_note(self.subject):
            return getattr(self.generator, method)(*arguments)

    def _due(self, method: str) -> bool:
        """Return whether to check the return value of a method now, and record that it was."""
        due = self._every_step or method not in self._checked
        self._checked.add(method)
        return due

    def _check_array(
        self, method: str, value: object, shape: tuple[int, ...], *, finite: bool = True
    ) -> None:
        name = f"{self.subject} returns a value from {method} that"
        check_array(value, shape, name, finite=finite, error=ConformanceError)

    def _check_state(self, method: str, state: Any, n: int) -> None:
        rule = f"must return a state from {method} that is a dict of numeric arrays"
        if not isinstance(state, dict):
            raise self.error(f"{rule}, not a {type(state).__name__}")
        for key, value in state.items():
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
                raise self.error(f"{rule}; {key!r} is not")
            if value.shape[:1] != (n,):
                raise self.error(f"{rule} with leading axis {n}; {key!r} has shape {value.shape}")
        if not n:  # a state without rows may have no keys
            return
        layout = _layout(state)
        self._layout = first = self._layout or layout
        if changed := {key for key, _ in layout.items() ^ first.items()}:
            text = f"changes keys, shapes or types of its state: {sorted(map(str, changed))}"
            raise self.error(text, "layout")


def _layout(state: State) -> Layout:
    return {key: (value.dtype, value.shape[1:]) for key, value in state.items()}
