"""The base class of adapters, and their random numbers."""

import math
import zlib
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Interval
from numba import njit
from numpy.typing import NDArray

from kinfeas.config import convert
from kinfeas.core import spatial
from kinfeas.core.backend import Backend, BackendWrapper, RobotState
from kinfeas.core.checks import check_array, check_state
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.motion import with_rows
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

Memory = dict[str, NDArray[Any]]

Number = float | tuple[float, float]
"""A number, or a range [low, high] from which each episode draws its number uniformly."""

_HOOKS = ("on_reset", "modify_command", "on_step", "modify_state")
_ALLOWED = Interval(ge=0.0, le=10_000.0)  # seconds, metres or radians

# Separate the random numbers of episodes' parameters, of `uniform`, and of the adapter classes.
_EPISODE, _UNIFORM = np.uint64(0x8CB92BA72F3D8DD7), 0xD1B54A32D192ED03
_SPREAD, _MASK = 0x9FB21C651E98DF25, 2**64 - 1


class Range(NamedTuple):
    """A closed interval."""

    low: float
    high: float


class Adapter(BackendWrapper):
    """A wrapper that changes a backend's commands and measurements by up to four hooks.

    `on_reset` returns the memory of new episodes, `modify_command` changes the command, `on_step`
    updates the memory with the measurement, and `modify_state` changes the measurement.
    `modify_state` may only depend on the state, the memory and the random numbers, and may be
    called twice. Rows must not depend on each other. An adapter has the abilities of its backend;
    a subclass replaces the one that it changes, and names the one that it `needs`.

    Random numbers depend on the episode's seed, the step, the class and the number of adapters of
    the same class that it wraps: adapters of other classes do not change them.

    Attributes:
        robot: Robot model.
        continuous: Whether each arm joint is continuous, shape (j,).
        ranges: Numeric parameters by name.
        memory: Arrays with leading axis n, by name; replaced and never written into.
    """

    stream: ClassVar[str | None] = None  # of random numbers; the name of the class by default
    late: ClassVar[bool] = False  # whether robots respond later; it then changes `response`
    needs: ClassVar[str] = ""
    """Ability of `Backend` that the adapter cannot do without; empty for none."""

    def __init_subclass__(cls) -> None:
        """Raise KinfeasError if a method of a new class has almost the name of a hook."""
        super().__init_subclass__()
        for name in vars(cls).keys() - set(dir(Adapter)):
            close = get_close_matches(name, _HOOKS, n=1, cutoff=0.85)
            if close and not name.startswith("_"):
                raise KinfeasError(f"{cls.__name__}.{name}: unknown hook, not {close[0]!r}")

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        numbers: Mapping[str, Number] | None = None,
        within: Interval | None = None,
    ) -> None:
        """Wrap a backend; its `numbers` must be `within` an interval, [0, 10,000] by default."""
        super().__init__(backend)
        self.robot, self.continuous, self.memory = robot, robot.continuous, Memory()
        self.ranges: dict[str, Range] = {}
        for name, value in (numbers or {}).items():
            ends = Range(*(value if isinstance(value, tuple) else (value, value)))
            if ends.low > ends.high:
                raise KinfeasError(f"{name} must be a number or an ascending range, not {value!r}")
            for end in ends:
                convert(Annotated[float, within or _ALLOWED], end, "parameters", name)
            self.ranges[name] = ends
        number, inner = 0, backend
        while isinstance(inner, BackendWrapper):
            number, inner = number + (type(inner) is type(self)), inner.backend
        stream = type(self).__name__ if self.stream is None else self.stream
        self._salt = np.uint64((zlib.crc32(stream.encode()) * _SPREAD + number) & _MASK)
        self._prefix = f"{type(self).__name__}.{number}."
        self._values: dict[str, Array] = {}
        self._seeds = self._steps = np.empty(0, dtype=np.uint64)
        self._subject, self._unchecked = f"adapter {type(self).__name__}", True
        self.resumable = backend.resumable and self

    def on_reset(self, state: RobotState) -> Memory:
        """Return the memory at the start of an episode in each row of `state`."""
        return {}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, shape (n, 6), and the joint targets, (n, j), for the backend."""
        return twist, targets

    def on_step(self, state: RobotState, dt: float) -> None:
        """Update the memory with the measurement after `dt` seconds."""

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the changed measurement."""
        return state

    def remember(self, **arrays: NDArray[Any]) -> None:
        """Replace the memory."""
        self.memory = arrays

    def number(self, name: str) -> Array:
        """Return the value of a parameter in each episode, shape (n, 1)."""
        return self._values[name]

    def mean(self, name: str) -> float:
        """Return the mean of a parameter over all episodes."""
        return sum(self.ranges[name]) / 2.0 if name in self.ranges else 0.0

    def normal(self, width: int) -> Array:
        """Return standard normal numbers for this step, shape (n, width)."""
        return normal(self._seeds + self._salt, self._steps, width)

    def uniform(self, width: int) -> Array:
        """Return uniform numbers in (0, 1] for this step, shape (n, width)."""
        return uniform(self._seeds + self._salt, self._steps, width)

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Set the seeds of new episodes, shape (m,), in the m `env_ids`."""
        if len(env_ids):
            self._fit(max(int(env_ids.max()) + 1, len(self._seeds)))
        self._seeds[env_ids], self._steps[env_ids] = seeds, 0
        super().seed(seeds, env_ids)

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Reset the backend and return the changed state of all n; shapes as in `Backend`."""
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._fit(len(state.base_pose))
        self._draw()
        with plugin_note(self._subject):
            fresh = self.on_reset(state)
        n, joints = state.joint_positions.shape
        for key, values in fresh.items():
            shape = (n, *np.shape(values)[1:])
            check_array(values, shape, f"{self._subject}: {key}", finite=False)
        if env_ids is None:
            self.memory = fresh
        else:
            self.memory = {
                key: with_rows(self.memory[key], env_ids, values[env_ids])
                for key, values in fresh.items()
            }
        self._unchecked = True
        with plugin_note(self._subject):
            measurement = self.modify_state(state)
        check_state(measurement, n, joints, f"{self._subject}: modify_state")
        return measurement

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send the changed command and return the changed state; shapes as in `Backend`."""
        with plugin_note(self._subject):
            twist, targets = self.modify_command(base_twist, joint_targets, dt)
        if self._unchecked:
            check_array(twist, base_twist.shape, f"{self._subject}: twist")
            check_array(targets, joint_targets.shape, f"{self._subject}: joint targets")
            self._unchecked = False
        state = self.backend.step(twist, targets, dt)
        self._steps = self._steps + np.uint64(1)
        with plugin_note(self._subject):
            self.on_step(state, dt)
            return self.modify_state(state)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return memory, seeds and steps with the backend's snapshot, if it is resumable."""
        assert self.backend.resumable is not None
        own = {"seeds": self._seeds, "steps": self._steps, **self.memory}
        named = {f"{self._prefix}{key}": values.copy() for key, values in own.items()}
        return {**self.backend.resumable.snapshot(), **named}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Restore a snapshot and return the changed state."""
        assert self.backend.resumable is not None
        own = {
            name.removeprefix(self._prefix): values.copy()
            for name, values in snapshot.items()
            if name.startswith(self._prefix)
        }
        self._seeds, self._steps = own.pop("seeds"), own.pop("steps")
        self.memory = own
        self._draw()
        return self.modify_state(self.backend.resumable.restore(snapshot))

    def _fit(self, n: int) -> None:
        """Resize seeds and steps to n rows; the seed of a new row is 0."""
        new = max(0, n - len(self._seeds))
        self._seeds, self._steps = (np.pad(a[:n], (0, new)) for a in (self._seeds, self._steps))

    def _draw(self) -> None:
        """Draw the parameters of all episodes; those of running episodes do not change."""
        seeds, steps = self._seeds + self._salt + _EPISODE, np.zeros_like(self._seeds)
        fractions = uniform(seeds, steps, len(self.ranges))
        for (name, (low, high)), fraction in zip(self.ranges.items(), fractions.T, strict=True):
            self._values[name] = low + (high - low) * fraction[:, np.newaxis]

    def joints(self, positions: Array) -> Array:
        """Return joint positions, shape (..., j), with continuous ones in (-pi, pi]."""
        beyond = self.continuous & (np.abs(positions) > np.pi)
        return np.where(beyond, spatial.wrap(positions), positions)


def measured(state: RobotState, **changes: Array) -> RobotState:
    """Return a changed measurement that keeps the true state."""
    return replace(state, true_state=state.true_state or state, **changes)


# Random numbers are hashes of seed and step: rows of a batch are independent, and a run can resume
# at any step.
@njit(cache=True)
def _hash(seed: Any, counter: Any) -> Any:
    """Return a number in (0, 1]: SplitMix64 (Steele, Lea and Flood, OOPSLA 2014)."""
    z = seed + (counter + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 1.0) / 9007199254740992.0


@njit(cache=True)
def normal(seeds: NDArray[np.uint64], steps: NDArray[np.uint64], width: int) -> Array:
    """Return standard normal numbers, shape (n, width), for seeds and steps of shape (n,)."""
    out = np.empty((len(seeds), width))
    for i in range(len(out)):
        for k in range(width):
            # Each step has sixteen counters of a seed, for eight numbers; Box-Muller transform.
            seed = seeds[i] + np.uint64(k // 8) * np.uint64(0xA0761D6478BD642F)
            counter = steps[i] * np.uint64(16) + np.uint64(2 * (k % 8))
            first, second = _hash(seed, counter), _hash(seed, counter + np.uint64(1))
            out[i, k] = math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)
    return out


@njit(cache=True)
def uniform(seeds: NDArray[np.uint64], steps: NDArray[np.uint64], width: int) -> Array:
    """Return numbers in (0, 1], shape (n, width), for seeds and steps of shape (n,)."""
    out = np.empty((len(seeds), width))
    for i in range(len(out)):
        for k in range(width):
            counter = steps[i] * np.uint64(width) + np.uint64(k)
            out[i, k] = _hash(seeds[i] + np.uint64(_UNIFORM), counter)
    return out
