"""The conformance check of adapters."""

from collections.abc import Sequence
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import PluginSpec
from kinfeas.control.assemble import build_simulator, with_adapters
from kinfeas.core.backend import ABILITIES, Backend, BackendWrapper, RobotState
from kinfeas.core.checks import ConformanceError, check_array, check_state
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.robots.robot import Robot

_ROWS, _STEPS, _DT = 4, 20, 0.1


def check_adapter(adapter: PluginSpec, robot: Robot, world: str = "analytic") -> None:
    """Raise if an adapter around the backend `world` breaks its contract; takes about a second.

    It must override a method or replace an ability; commands and measurements must be finite and
    keep their shapes; no row may depend on the others, nor on their resets; the inputs must stay as
    they are; and equal seeds must make episodes repeatable.

    Raises:
        KinfeasError: If the adapter cannot be built, or a rule is broken.
    """
    together = _run(adapter, robot, world, range(_ROWS))
    if not np.array_equal(together, _run(adapter, robot, world, range(_ROWS))):
        raise ConformanceError(f"{_name(adapter)} breaks the rule: repeats an episode of its seed")
    alone = _run(adapter, robot, world, [_ROWS - 1])
    if not np.allclose(alone[:, 0], together[:, -1], atol=1e-6):
        raise ConformanceError(f"{_name(adapter)} breaks the rule: no row depends on the others")


class _Checked(BackendWrapper):
    """A backend that checks the commands it gets."""

    def __init__(self, backend: Backend, sender: str) -> None:
        super().__init__(backend)
        self._sender = sender

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._shape = state.joint_positions.shape
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        check_array(base_twist, (self._shape[0], 6), f"{self._sender}: twist")
        check_array(joint_targets, self._shape, f"{self._sender}: joint targets")
        return self.backend.step(base_twist, joint_targets, dt)


def _run(adapter: PluginSpec, robot: Robot, world: str, seeds: Sequence[int]) -> Array:
    """Return the measurements of each step, shape (steps, n, d)."""
    inner = _Checked(build_simulator(world, {}, robot=robot), _name(adapter))
    with closing(inner):
        backend = with_adapters(inner, [adapter], robot)
        _check_effect(backend, inner, _name(adapter))
        n, home = len(seeds), robot.home["home"]
        rngs, measured = [np.random.default_rng(seed) for seed in seeds], []
        backend.seed(np.array(seeds, dtype=np.uint64), np.arange(n))
        backend.reset(np.tile(IDENTITY, (n, 1)), np.tile(home, (n, 1)))
        for step in range(_STEPS):
            if n > 1 and step == _STEPS // 2:
                backend.seed(np.array([_ROWS], dtype=np.uint64), np.array([0]))
                backend.reset(IDENTITY[np.newaxis], home[np.newaxis], np.array([0]))
            twist, arm = np.zeros((n, 6)), np.tile(home, (n, 1))
            twist[:, [0, 1, 5]] = [rng.uniform(-0.2, 0.2, 3) for rng in rngs]
            arm += [rng.uniform(-0.01, 0.01, len(home)) for rng in rngs]
            given = twist.copy(), arm.copy()
            state = backend.step(*given, _DT)
            check_state(state, n, len(home), f"{_name(adapter)}: modify_state")
            if not np.array_equal(np.hstack(given), np.hstack([twist, arm])):
                raise ConformanceError(f"{_name(adapter)} writes into its input")
            parts = state.base_pose, state.joint_positions, state.ee_in_base, state.localised
            measured.append(np.hstack([part for part in parts if part is not None]))
    return np.stack(measured)


def _check_effect(backend: Backend, inner: Backend, name: str) -> None:
    """Raise unless an adapter overrides a method of its base class or replaces an ability."""
    bases = type(backend).__mro__
    base = bases[bases.index(BackendWrapper) - 1]  # `Adapter`, or a class that defines `step`
    methods = [key for key in dir(base) if not key.startswith("_") and callable(getattr(base, key))]
    own = [key for key in methods if getattr(type(backend), key) is not getattr(base, key)]
    replaced = [key for key in ABILITIES if getattr(backend, key) is not getattr(inner, key)]
    if base is not type(backend) and not own and set(replaced) <= {"resumable"}:
        raise ConformanceError(f"{name} overrides no method of {base.__name__}")


def _name(adapter: PluginSpec) -> str:
    return f"adapter {adapter.name!r}"
