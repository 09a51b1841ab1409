"""Conformance checks of plugins, for their tests."""

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
from kinfeas.core.backend import (
    ABILITIES,
    Backend,
    BackendWrapper,
    RobotState,
    closed_on_error,
)
from kinfeas.core.checks import CheckedMotion, ConformanceError, check_array, check_state
from kinfeas.core.errors import PLUGIN_ERRORS, plugin_note
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import IDENTITY, Array, planar_pose
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.testing.rules import RULES, Probe, Trial, describe, run_trial

__all__ = [
    "RULES", "ConformanceError", "Finding", "Trial", "check_adapter", "check_backend",
    "check_filter", "check_motion_generator", "check_policy", "examine",
]  # fmt: skip

# episodes, steps, and the step at which the first row restarts, except for motion generators
_ROWS, _STEPS, _RESTART = 6, 20, 10
_DT = 0.1  # s, control period of adapters and backends
_PLACED, _TURNED = 0.02, 0.02  # largest errors of base and arm of backends, m and joint units
_SPEED, _HEADING = 0.1, 0.8  # of their base, m/s and rad: not 0, as twists are in world axes


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
    run, subject = partial(_actions, policy, robot), f"policy {type(policy).__name__}"
    together = _check_rows(subject, run, "repeats its actions after reset")
    try:
        copy = pickle.loads(pickle.dumps(policy))  # noqa: S301 - in memory, nothing is read
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ConformanceError(f"{subject} cannot be pickled: {error}") from error
    same = np.array_equal(together, _actions(copy, robot, range(_ROWS)))
    _require(same, subject, "acts alike as a copy by pickle")


def _actions(policy: Policy, robot: Robot, episodes: Sequence[int]) -> Array:
    """Return the actions of each step, shape (steps, n, a)."""
    subject = f"policy {type(policy).__name__}"
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
        with plugin_note(subject):
            action = policy.act(observed)
        shape = len(episodes), world.action_size
        check_array(action, shape, f"{subject}: the action", error=ConformanceError)
        if np.abs(action).max() > 1.0:
            raise ConformanceError(f"{subject}: the action must be in [-1, 1]")
        for key, values in before.items():
            if not np.array_equal(values, getattr(observed, key), equal_nan=True):
                raise ConformanceError(f"{subject} writes into its input: {key}")
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
    subject = f"adapter {adapter.name!r}"

    def build() -> Backend:
        inner = _Checked(build_simulator(world, {}, robot=robot), subject)
        with closed_on_error(inner):
            backend = with_adapters(inner, [adapter], robot)
            _check_effect(backend, inner, subject)
        return backend

    run = partial(_measured, build, robot, f"{subject}: modify_state")
    _check_rows(subject, run, "repeats an episode of its seed")


def check_backend(backend: PluginSpec, robot: Robot) -> None:
    """Raise if a simulator breaks the contract of `Backend`; takes about a second.

    Measurements must be finite and have their shapes; robots must be where a reset puts them, and
    move as commanded; otherwise as `check_adapter`.

    Raises:
        KinfeasError: If the backend cannot be built or moves a real robot, or a rule is broken.
    """
    subject = f"backend {backend.name!r}"
    build = partial(build_simulator, backend.name, backend.parameters, robot=robot)
    run = partial(_measured, build, robot, f"{subject}: step")
    _check_rows(subject, run, "repeats an episode of its seed")
    home = robot.home["home"][np.newaxis]
    with closing(build()) as simulator:
        start = planar_pose(*np.array([[0.5], [-0.3], [_HEADING]]))
        state = simulator.reset(start, home)
        check_state(state, 1, home.shape[1], f"{subject}: reset")
        error = np.linalg.norm(state.base_pose[0, :3] - start[0, :3])
        placed = error < _PLACED and np.abs(state.joint_positions - home).max() < _TURNED
        _require(placed, subject, "reset puts robots where they are asked for")
        aim = np.clip(home + 2.0 * _TURNED, *robot.joint_limits)
        velocity = _SPEED * np.array([np.cos(_HEADING), np.sin(_HEADING)])
        for targets in np.linspace(home, aim, _STEPS):  # gently: motors may be weak
            state = simulator.step(np.append(velocity, np.zeros(4))[np.newaxis], targets, _DT)
        path = velocity * _STEPS * _DT
        error = np.linalg.norm(state.base_pose[0, :2] - start[0, :2] - path)
        _require(error < np.linalg.norm(path) / 2.0, subject, "step moves bases by the world twist")
        turned = np.abs(state.joint_positions - aim).max() < _TURNED
        _require(turned, subject, "step moves arms to the joint targets")


def check_filter(command_filter: PluginSpec, robot: Robot, world: str = "analytic") -> None:
    """Raise if a filter breaks the contract of `CommandFilter` in the backend `world`.

    Commands must be finite and of shape (n, a); no row may depend on the others; the period must
    stay as it is; and a `reset` must make episodes repeatable, also of single rows.

    Raises:
        KinfeasError: If the filter cannot be built, or a rule is broken.
    """
    subject = f"filter {command_filter.name!r}"
    config = WorldConfig(max_failures=10**6, filters=(command_filter,), backend=world)
    run = partial(_filtered, config, robot)
    _check_rows(subject, run, "repeats its commands after reset")


def _filtered(config: WorldConfig, robot: Robot, episodes: Sequence[int]) -> Array:
    """Return commands, bases and arms of each step, shape (steps, n, d), for random actions."""
    world, rngs, measured = World(robot, load_task("ggr"), config, seed=0), _rngs(episodes), []
    with closing(world):
        world.start(list(episodes))
        for step in range(_STEPS):
            if len(episodes) > 1 and step == _RESTART:
                rngs[0] = np.random.default_rng(_ROWS)
                world.start([_ROWS], np.array([0]))
            world.step(np.stack([rng.uniform(-1.0, 1.0, world.action_size) for rng in rngs]))
            robots = world.loop.robots
            parts = world.loop.previous_command, robots.base_pose, robots.joint_positions
            measured.append(np.hstack(parts))
    return np.stack(measured)


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


def _measured(
    build: Callable[[], Backend], robot: Robot, source: str, seeds: Sequence[int]
) -> Array:
    """Return the measurements of each step, shape (steps, n, d)."""
    with closing(build()) as backend:
        n, home = len(seeds), robot.home["home"]
        rngs, measured = _rngs(seeds), []
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
            arguments = twist.copy(), arm.copy()
            state = backend.step(*arguments, _DT)
            check_state(state, n, len(home), source)
            if not np.array_equal(np.hstack(arguments), np.hstack([twist, arm])):
                raise ConformanceError(f"{source.partition(':')[0]} writes into its input")
            parts = state.base_pose, state.joint_positions, state.ee_in_base, state.localised
            measured.append(np.hstack([part for part in parts if part is not None]))
    return np.stack(measured)


def _rngs(seeds: Sequence[int]) -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in seeds]


def _check_effect(backend: Backend, inner: Backend, name: str) -> None:
    """Raise unless an adapter overrides a method of its base class or replaces an ability."""
    bases = type(backend).__mro__
    base = bases[bases.index(BackendWrapper) - 1]  # `Adapter`, or a class that defines `step`
    methods = [key for key in dir(base) if not key.startswith("_") and callable(getattr(base, key))]
    own = [key for key in methods if getattr(type(backend), key) is not getattr(base, key)]
    replaced = [key for key in ABILITIES if getattr(backend, key) is not getattr(inner, key)]
    if base is not type(backend) and not own and set(replaced) <= {"resumable"}:
        raise ConformanceError(f"{name} overrides no method of {base.__name__}")


def _check_rows(subject: str, run: Callable[[Sequence[int]], Array], repeats: str) -> Array:
    """Check that episodes repeat and do not depend on the batch; return the batch's values."""
    together = run(range(_ROWS))
    _require(np.array_equal(together, run(range(_ROWS))), subject, repeats)
    for rule, episode, row in (
        ("no row depends on the others", _ROWS - 1, together[:, -1]),
        ("reset begins single rows anew", _ROWS, together[_RESTART:, 0]),
    ):
        alone = run([episode])[: len(row), 0]
        _require(np.allclose(alone, row, atol=1e-6), subject, rule)
    return together


def _require(holds: bool | np.bool_, subject: str, rule: str) -> None:
    if not holds:
        raise ConformanceError(f"{subject} breaks the rule: {rule}")
