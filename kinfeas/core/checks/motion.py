"""A motion generator whose every answer is looked at: nothing malformed gets into a loop."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinfeas.core.checks.arrays import are_unit, instead, sound
from kinfeas.core.checks.signatures import PARAMETERS, require_parameters
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Demonstrated, MotionGenerator, State
from kinfeas.core.plugin_errors import BLAMED, PluginErrors, package_of
from kinfeas.core.spatial import Array

_METHODS = ("start", "goal_pose", "twist")

Layout = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]


class ConformanceError(KinfeasError):
    """A motion generator breaks its contract; the sentence names it and what it broke.

    Attributes:
        rule: Short name of what it broke, one of `testing.RULES`.
    """

    def __init__(self, message: str, rule: str = "form") -> None:
        super().__init__(message)
        self.rule = rule


class CheckedMotion:
    """A motion generator that passes on another one's answers if they have the right form.

    Shapes and types are checked at each call, and that twists and goals are finite; unit
    quaternions when a motion begins. States keep the layout of the first one, so that rows of one
    can be put into another. What the generator's own code raises becomes an error that names it and
    the line.

    Args:
        generator: Who answers.
        name: What to call it in errors; the name of its class by default.

    Attributes:
        demonstrated: Whether the base was demonstrated, too.

    Raises:
        ConformanceError: If it lacks a method; from every method, if the answer is malformed.
        SignatureError: If a method takes other parameters.
    """

    def __init__(self, generator: MotionGenerator, name: str = "") -> None:
        kind, package = type(generator).__name__, package_of(generator)
        self.generator = generator
        self.demonstrated = isinstance(generator, Demonstrated)
        self.subject = f"motion generator {name or kind}"
        self._layout: Layout | None = None  # until there is a state
        lacks = [one for one in _METHODS if not callable(getattr(generator, one, None))]
        if lacks:
            words = ", ".join(lacks)
            raise self.error(
                f"must have the methods start, goal_pose and twist; {kind} lacks {words}"
            )
        require_parameters(generator, PARAMETERS, self.subject)
        self._start, self._goal_pose, self._twist, self._base_pose = (
            PluginErrors(f"{self.subject} fails in {method}:", package)
            for method in ("start", "goal_pose", "twist", "base_pose")
        )

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions, shapes (n, 7), (n, 7), n; there is at least one."""
        with self._start:
            state = self.generator.start(ee_pose, target_pose, rngs)
        self._require_state("start", state, len(ee_pose))
        if len(ee_pose):  # the state of no motion may have no keys
            self._require_layout(state)
        self._require_unit(self.goal_pose(state, target_pose))
        return state

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        try:
            goal = self.generator.goal_pose(state, target_pose)
        except BLAMED as error:
            self._goal_pose.blame(error)
            raise
        shape = (len(target_pose), 7)
        if not sound(goal, shape):
            self._require_form("goal_pose", goal, shape)
            self._require_finite("goal_pose", goal)
        return goal

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        try:
            answer = self.generator.twist(state, ee_pose, target_pose, dt)
        except BLAMED as error:
            self._twist.blame(error)
            raise
        if self._layout is None and len(ee_pose):  # of a run that goes on where another left off
            self._layout = _layout(state)
        if self._layout is None or not _plausible(answer, len(ee_pose), self._layout):
            self._require_step(answer, len(ee_pose))
        return answer

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return where the base was demonstrated to be, shape (n, 7); NaN where it was not."""
        n = len(target_pose)
        if not (self.demonstrated and isinstance(self.generator, Demonstrated)):
            return np.full((n, 7), np.nan)
        with self._base_pose:
            pose = self.generator.base_pose(state, target_pose)
        self._require_form("base_pose", pose, (n, 7))
        return pose

    def error(self, broken: str, rule: str = "form") -> ConformanceError:
        """Return an error with the sentence `broken`, which has the generator as its subject."""
        return ConformanceError(f"{self.subject} {broken}", rule)

    def _require_step(self, answer: Any, n: int) -> None:
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise self.error("must return a pair from twist: the twist and the next state")
        self._require_form("twist", answer[0], (n, 6))
        self._require_finite("twist", answer[0])
        self._require_state("twist", answer[1], n)
        if n:
            self._require_layout(answer[1])

    def _require_state(self, method: str, state: State, n: int) -> None:
        rule = f"must return a state from {method} that is a dict of numeric arrays"
        if not isinstance(state, dict):
            raise self.error(f"{rule}, not a {type(state).__name__}")
        for key, value in state.items():
            if not isinstance(key, str):
                raise self.error(f"{rule} by strings, and {key!r} is none")
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
                raise self.error(f"{rule}, and {key!r} is not")
            if not value.ndim or len(value) != n:
                raise self.error(f"{rule} of leading axis {n}, and {key!r} has shape {value.shape}")

    def _require_layout(self, state: State) -> None:
        found = _layout(state)
        self._layout = first = found if self._layout is None else self._layout
        every = sorted(found.keys() | first.keys())
        keys = [key for key in every if found.get(key) != first.get(key)]
        if keys:
            raise self.error(f"changes the keys, shapes or types of its state: {keys}", "layout")

    def _require_form(self, method: str, value: Array, shape: tuple[int, ...]) -> None:
        if got := instead(value, shape):
            raise self.error(f"must return an array of shape {shape} from {method}, not {got}")

    def _require_finite(self, method: str, value: Array) -> None:
        if not np.isfinite(value).all():
            raise self.error(f"returns numbers from {method} that are not finite")

    def _require_unit(self, goal: Array) -> None:
        if not are_unit(goal):
            raise self.error(
                "returns a goal_pose whose quaternion is not of unit length", "quaternions"
            )


def _plausible(answer: Any, n: int, layout: Layout) -> bool:
    """Return whether an answer of `twist` is surely sound; at each step, so as cheap as can be."""
    if type(answer) is not tuple or len(answer) != 2:
        return False
    twist, after = answer
    if not sound(twist, (n, 6)) or type(after) is not dict or len(after) != len(layout):
        return False
    for key, value in after.items():
        if type(value) is not np.ndarray or value.shape[:1] != (n,):
            return False
        if layout.get(key) != (value.dtype, value.shape[1:]):
            return False
    return True


def _layout(state: State) -> Layout:
    """Return what all motions of a state have in common: type and shape by key."""
    return {key: (value.dtype, value.shape[1:]) for key, value in state.items()}
