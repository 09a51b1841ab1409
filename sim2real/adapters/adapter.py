"""What all adapters share: they pass on what a backend can, and say what they change of it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import Interval
from kinfeas.control.adapters import chain
from kinfeas.core import spatial
from kinfeas.core.backend import (
    Backend,
    BackendWrapper,
    RealTimeBackend,
    Resumable,
    RobotState,
    Stochastic,
    SupportsGripper,
    SupportsObstacleDistances,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.plugin_errors import is_own
from kinfeas.core.rows import with_rows
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters import draws
from kinfeas.sim2real.adapters.checked_hooks import CheckedHooks, Hooks
from kinfeas.sim2real.adapters.draws import Number, Range

Memory = dict[str, NDArray[Any]]

_MOST = 10_000.0  # of seconds, metres or radians: far more than any robot has use for


class Adapter(BackendWrapper):
    """A backend around a backend. A subclass overrides what it changes, of these four.

    `on_reset` says what is remembered from the start of an episode on, `modify_command` changes
    what is commanded, `on_step` takes note of what was measured after it, and `modify_state` says
    what is seen of that. `modify_state` is a function of the state, the memory and the draws alone
    and may be asked twice. No row may depend on others. An adapter can what its backend can: it has
    `grip`, `obstacle_distances`, `read` and `stop`, `snapshot` and `restore` if that has them.

    What is drawn depends on the episode's seed, the step, the class and how many of the same class
    stand within: an adapter more or less in the list leaves the draws of the others alone.

    Attributes:
        backend: What is wrapped.
        robot: Whom it moves.
        continuous: Whether each arm joint turns without end, shape (j,).
        ranges: The parameters that are numbers, by name.
        memory: What is remembered, arrays with leading axis n, replaced and never written into.
    """

    stream: ClassVar[str | None] = None
    """Name of the stream of draws; the class's by default."""

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        numbers: Mapping[str, Number] | None = None,
        within: Interval | None = None,
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What is wrapped.
            robot: Whom it moves.
            numbers: Parameters by name: a number, or a range that each episode draws from.
            within: What numbers are allowed; those in [0, 10,000] by default.

        Raises:
            ValueError: If a number is not allowed.
        """
        self.backend, self.robot, self.memory = backend, robot, Memory()
        self.continuous = robot.continuous
        allowed = within or Interval(low=0.0, high=_MOST)
        self.ranges: dict[str, Range] = {
            name: draws.read_range(name, value, allowed) for name, value in (numbers or {}).items()
        }
        number = sum(type(link) is type(self) for link in chain(backend))
        name = type(self).__name__ if self.stream is None else self.stream
        self._salt, self._prefix = draws.salt(name, number), f"{type(self).__name__}.{number}."
        self._values: dict[str, Array] = {}
        self._seeds = self._steps = np.empty(0, dtype=np.uint64)
        self._hooks: Hooks = self
        if isinstance(backend, SupportsGripper):
            self.grip = backend.grip
        if isinstance(backend, SupportsObstacleDistances):
            self.obstacle_distances = backend.obstacle_distances
        if isinstance(backend, RealTimeBackend):
            self.read, self.stop = backend.read, backend.stop
        if isinstance(backend, Resumable):
            self.snapshot, self.restore = self._snapshot, self._restore

    def look_at_hooks(self, subject: str) -> None:
        """Look from now on at what the hooks of a class from outside return.

        Args:
            subject: What errors call the adapter.

        Raises:
            KinfeasError: If a subclass has not called the constructor.
        """
        if not hasattr(self, "_hooks"):
            raise KinfeasError(f"{subject} must call the constructor of Adapter in its own")
        if not is_own(self):
            self._hooks = CheckedHooks(self, subject)

    def on_reset(self, state: RobotState) -> Memory:
        """Return what to remember from now on if an episode begins in each row of `state`."""
        return {}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, shape (n, 6), and the joint targets, (n, j), that are passed on."""
        return twist, targets

    def on_step(self, state: RobotState, dt: float) -> None:
        """Take note of what was measured after `dt` seconds."""

    def modify_state(self, state: RobotState) -> RobotState:
        """Return what is seen of what was measured."""
        return state

    def remember(self, **arrays: NDArray[Any]) -> None:
        """Replace what is remembered of the n rows."""
        self.memory = arrays

    def number(self, name: str) -> Array:
        """Return the value of a parameter in each episode, shape (n, 1)."""
        return self._values[name]

    def normal(self, width: int) -> Array:
        """Return this step's standard normal draws, shape (n, width)."""
        return draws.normal(self._seeds + self._salt, self._steps, width)

    def uniform(self, width: int) -> Array:
        """Return this step's uniform draws in (0, 1], shape (n, width)."""
        return draws.uniform(self._seeds + self._salt, self._steps, width)

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Begin new episodes with one seed each, shape (m,), in the m `env_ids`."""
        if len(env_ids):
            self._fit(max(int(env_ids.max()) + 1, len(self._seeds)))
        self._seeds[env_ids], self._steps[env_ids] = seeds, 0
        if isinstance(self.backend, Stochastic):
            self.backend.seed(seeds, env_ids)

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Begin new episodes and return what is seen of all n; shapes as in `Backend`."""
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._fit(len(state.base_pose))
        self._draw()
        fresh = self._hooks.on_reset(state)
        if env_ids is None:
            self.memory = fresh
        else:
            self.memory = {
                key: with_rows(self.memory[key], env_ids, values[env_ids])
                for key, values in fresh.items()
            }
        return self._hooks.modify_state(state)

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Pass on a changed command and return what is seen after it; shapes as in `Backend`."""
        twist, targets = self._hooks.modify_command(base_twist, joint_targets, dt)
        state = self.backend.step(twist, targets, dt)
        self._steps = self._steps + np.uint64(1)
        self._hooks.on_step(state, dt)
        return self._hooks.modify_state(state)

    def close(self) -> None:
        """Close the wrapped backend."""
        self.backend.close()

    def _snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the memory and how far the draws have come, beside the backend's state."""
        assert isinstance(self.backend, Resumable)
        own = {"seeds": self._seeds, "steps": self._steps, **self.memory}
        named = {f"{self._prefix}{key}": values.copy() for key, values in own.items()}
        return {**self.backend.snapshot(), **named}

    def _restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Take on a state that `snapshot` returned and return what is seen in it."""
        assert isinstance(self.backend, Resumable)
        own = {
            name.removeprefix(self._prefix): values.copy()
            for name, values in snapshot.items()
            if name.startswith(self._prefix)
        }
        self._seeds, self._steps = own.pop("seeds"), own.pop("steps")
        self.memory = own
        self._draw()
        return self._hooks.modify_state(self.backend.restore(snapshot))

    def _fit(self, n: int) -> None:
        """Make room for n rows; a row that nobody has seeded has seed 0."""
        kept = min(n, len(self._seeds))
        seeds, steps = (np.zeros(n, dtype=np.uint64) for _ in "ab")
        seeds[:kept], steps[:kept] = self._seeds[:kept], self._steps[:kept]
        self._seeds, self._steps = seeds, steps

    def _draw(self) -> None:
        """Draw the numbers of all episodes; those of old ones stay what they are."""
        shares = draws.once(self._seeds + self._salt, len(self.ranges))
        each = zip(self.ranges.items(), shares.T, strict=True)
        self._values = {name: one.draw(share[:, np.newaxis]) for (name, one), share in each}

    def turned(self, start: Array, end: Array) -> Array:
        """Return how far joints move from `start` to `end`, shape (..., j), the short way."""
        return np.where(self.continuous, spatial.wrap(end - start), end - start)

    def joints(self, positions: Array) -> Array:
        """Return joint positions, shape (..., j), with continuous ones in (-pi, pi]."""
        beyond = self.continuous & (np.abs(positions) > np.pi)
        return np.where(beyond, spatial.wrap(positions), positions)


def seen(state: RobotState, **changes: Array) -> RobotState:
    """Return a state as a sensor shows it, with what really is beside it."""
    return replace(state, true_state=state.true_state or state, **changes)
