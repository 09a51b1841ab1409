"""Conformance checks of motion generators, policies and adapters, for tests of plugins."""

import pickle
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import PluginSpec
from kinfeas.control.assemble import build_simulator, with_adapters
from kinfeas.core.backend import ABILITIES, Backend, BackendWrapper, RobotState
from kinfeas.core.checks import CheckedMotion, ConformanceError, check_array, check_state
from kinfeas.core.errors import PLUGIN_ERRORS, plugin_note
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.testing.rules import RULES, Probe, Trial, describe, run_trial

__all__ = [
    "RULES", "ConformanceError", "Finding", "Trial", "check_adapter", "check_motion_generator",
    "check_policy", "examine",
]  # fmt: skip

_ROWS, _STEPS, _RESTART = 6, 20, 10  # of the checks of policies and adapters
_DT = 0.1  # s, of those of adapters


@dataclass(frozen=True)
class Finding:
    """Result of one rule."""

    rule: str  # key of `RULES`
    broken: str | None  # description of a violation; None if none was found
    checked: bool  # whether the rule was checked completely; severe violations end the test

    @property
    def kept(self) -> bool:
        """Whether the rule was checked completely without a violation."""
        return self.checked and self.broken is None

    def facts(self) -> dict[str, object]:
        """Return the finding for a JSON file, with the description of the rule."""
        text = RULES[self.rule]
        return {"rule": self.rule, "text": text, "checked": self.checked, "broken": self.broken}


def check_motion_generator(generator: MotionGenerator, **trial: Any) -> None:
    """Check that a generator fulfils the contract of `MotionGenerator`; takes about a second.

    The keyword arguments are the attributes of `Trial`.

    Raises:
        ConformanceError: With the first broken one of `RULES`.
    """
    probe = Probe(CheckedMotion(generator, every_step=True), Trial(**trial))
    run_trial(probe)
    for rule, broken in probe.violations.items():
        raise ConformanceError(broken, rule)


def examine(
    generator: MotionGenerator,
    trial: Trial | None = None,
    name: str = "",
    on_step: Callable[[], None] | None = None,
) -> list[Finding]:
    """Return the result of each of `RULES`, in order; `on_step` is called after each step.

    Messages have the `name` of the generator, its class by default.
    """
    probe = Probe(CheckedMotion(generator, name, every_step=True), trial or Trial())
    violations, ended = probe.violations, False
    try:
        run_trial(probe, on_step)
        ended = True
    except ConformanceError as error:
        violations[error.rule] = str(error)
    except PLUGIN_ERRORS as error:
        violations["form"] = describe(error, probe.motion)
    return [Finding(rule, violations.get(rule), ended or rule in violations) for rule in RULES]


def check_policy(policy: Policy, robot: Robot) -> None:
    """Raise if a policy breaks its contract; takes about a second.

    Actions must be finite, in [-1, 1] and of shape (n, action size); no row may depend on the
    others; the inputs must stay as they are; a `reset` must make episodes repeatable, also of
    single rows; and a copy made by pickle, as worker processes get it, must act alike.

    Raises:
        ConformanceError: If a rule is broken.
    """
    run = partial(_run, policy, robot)
    together = _check_rows(policy, run, "repeats its actions after reset")
    try:
        copy = pickle.loads(pickle.dumps(policy))  # noqa: S301 - in memory, nothing is read
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ConformanceError(f"{_subject(policy)} cannot be pickled: {error}") from error
    same = np.array_equal(together, _run(copy, robot, range(_ROWS)))
    _require(same, policy, "acts alike as a copy by pickle")


def _run(policy: Policy, robot: Robot, episodes: Sequence[int]) -> Array:
    """Return the actions of each step, shape (steps, n, a)."""
    world = World(robot, load_task("ggr"), WorldConfig(max_failures=10**6), seed=0)
    world.loop.set_policy(policy)
    world.start(list(episodes))
    actions = []
    for step in range(_STEPS):
        if len(episodes) > 1 and step == _RESTART:
            world.start([_ROWS], np.array([0]))
        observed = world.loop.observation
        arrays = {k: value for k, value in vars(observed).items() if isinstance(value, np.ndarray)}
        before = {key: value.copy() for key, value in arrays.items()}
        with plugin_note(_subject(policy)):
            action = policy.act(observed)
        shape, subject = (len(episodes), world.action_size), f"{_subject(policy)}: the action"
        check_array(action, shape, subject, error=ConformanceError)
        if np.abs(action).max() > 1.0:
            raise ConformanceError(f"{subject} must be in [-1, 1]")
        for key, values in before.items():
            if not np.array_equal(values, getattr(observed, key), equal_nan=True):
                raise ConformanceError(f"{_subject(policy)} writes into its input: {key}")
        actions.append(action.copy())
        world.step(action)
    return np.stack(actions)


def check_adapter(adapter: PluginSpec, robot: Robot, world: str = "analytic") -> None:
    """Raise if an adapter around the backend `world` breaks its contract; takes about a second.

    It must override a method or replace an ability; commands and measurements must be finite and
    keep their shapes; no row may depend on the others, nor on their resets; the inputs must stay as
    they are; and equal seeds must make episodes repeatable, also after a reset of single rows.

    Raises:
        KinfeasError: If the adapter cannot be built, or a rule is broken.
    """
    run = partial(_measured, adapter, robot, world)
    _check_rows(adapter, run, "repeats an episode of its seed")


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


def _measured(adapter: PluginSpec, robot: Robot, world: str, seeds: Sequence[int]) -> Array:
    """Return the measurements of each step, shape (steps, n, d)."""
    inner = _Checked(build_simulator(world, {}, robot=robot), _subject(adapter))
    with closing(inner):
        backend = with_adapters(inner, [adapter], robot)
        _check_effect(backend, inner, _subject(adapter))
        n, home = len(seeds), robot.home["home"]
        rngs, measured = [np.random.default_rng(seed) for seed in seeds], []
        backend.seed(np.array(seeds, dtype=np.uint64), np.arange(n))
        backend.reset(np.tile(IDENTITY, (n, 1)), np.tile(home, (n, 1)))
        for step in range(_STEPS):
            if n > 1 and step == _RESTART:
                rngs[0] = np.random.default_rng(_ROWS)
                backend.seed(np.array([_ROWS], dtype=np.uint64), np.array([0]))
                backend.reset(IDENTITY[np.newaxis], home[np.newaxis], np.array([0]))
            twist, arm = np.zeros((n, 6)), np.tile(home, (n, 1))
            twist[:, [0, 1, 5]] = [rng.uniform(-0.2, 0.2, 3) for rng in rngs]
            arm += [rng.uniform(-0.01, 0.01, len(home)) for rng in rngs]
            given = twist.copy(), arm.copy()
            state = backend.step(*given, _DT)
            check_state(state, n, len(home), f"{_subject(adapter)}: modify_state")
            if not np.array_equal(np.hstack(given), np.hstack([twist, arm])):
                raise ConformanceError(f"{_subject(adapter)} writes into its input")
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


def _check_rows(
    plugin: Policy | PluginSpec, run: Callable[[Sequence[int]], Array], repeats: str
) -> Array:
    """Check that episodes repeat, and are alone as in a batch; return those of the batch."""
    together = run(range(_ROWS))
    _require(np.array_equal(together, run(range(_ROWS))), plugin, repeats)
    for rule, episode, row in (
        ("no row depends on the others", _ROWS - 1, together[:, -1]),
        ("reset begins single rows anew", _ROWS, together[_RESTART:, 0]),
    ):
        alone = run([episode])[: len(row), 0]
        _require(np.allclose(alone, row, atol=1e-6), plugin, rule)
    return together


def _require(holds: bool, plugin: Policy | PluginSpec, rule: str) -> None:
    if not holds:
        raise ConformanceError(f"{_subject(plugin)} breaks the rule: {rule}")


def _subject(plugin: Policy | PluginSpec) -> str:
    if isinstance(plugin, PluginSpec):
        return f"adapter {plugin.name!r}"
    return f"policy {type(plugin).__name__}"
