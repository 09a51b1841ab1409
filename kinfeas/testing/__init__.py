"""Conformance checks of motion generators, policies and adapters, for tests of plugins."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinfeas.core.checks import CheckedMotion, ConformanceError, check_array
from kinfeas.core.errors import PLUGIN_ERRORS, plugin_note
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.testing.adapters import check_adapter
from kinfeas.testing.rules import RULES, Probe, Trial, describe, run_trial

__all__ = [
    "RULES", "ConformanceError", "Finding", "Trial", "check_adapter", "check_motion_generator",
    "check_policy", "examine",
]  # fmt: skip

_ROWS, _STEPS = 6, 20  # of the check of policies


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
        violations["form"] = describe(error, probe.motion.subject)
    return [Finding(rule, violations.get(rule), ended or rule in violations) for rule in RULES]


def check_policy(policy: Policy, robot: Robot) -> None:
    """Raise if a policy breaks its contract; takes about a second.

    Actions must be finite, in [-1, 1] and of shape (n, action size); no row may depend on the
    others; the inputs must stay as they are; a `reset` must make episodes repeatable; and a copy
    made by pickle, as worker processes get it, must act alike.

    Raises:
        ConformanceError: If a rule is broken.
    """
    together = _run(policy, robot, range(_ROWS))
    try:
        copy = pickle.loads(pickle.dumps(policy))  # noqa: S301 - in memory, nothing is read
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ConformanceError(f"{_name(policy)} cannot be pickled: {error}") from error
    for rule, again in (
        ("repeats its actions after reset", _run(policy, robot, range(_ROWS))),
        ("acts alike as a copy by pickle", _run(copy, robot, range(_ROWS))),
    ):
        if not np.array_equal(together, again):
            raise ConformanceError(f"{_name(policy)} breaks the rule: {rule}")
    alone = _run(policy, robot, [_ROWS - 1])
    if not np.allclose(alone[:, 0], together[:, -1], atol=1e-6):
        raise ConformanceError(f"{_name(policy)} breaks the rule: no row depends on the others")


def _run(policy: Policy, robot: Robot, episodes: "range | list[int]") -> Array:
    world = World(robot, load_task("ggr"), WorldConfig(max_failures=10**6), seed=0)
    world.loop.set_policy(policy)
    world.start(list(episodes))
    actions = []
    for _ in range(_STEPS):
        observed = world.loop.observation
        arrays = {k: value for k, value in vars(observed).items() if isinstance(value, np.ndarray)}
        before = {key: value.copy() for key, value in arrays.items()}
        with plugin_note(_name(policy)):
            action = policy.act(observed)
        shape, subject = (len(episodes), world.action_size), f"{_name(policy)}: the action"
        check_array(action, shape, subject, error=ConformanceError)
        if np.abs(action).max() > 1.0:
            raise ConformanceError(f"{subject} must be in [-1, 1]")
        for key, values in before.items():
            if not np.array_equal(values, getattr(observed, key), equal_nan=True):
                raise ConformanceError(f"{_name(policy)} writes into its input: {key}")
        actions.append(action.copy())
        world.step(action)
    return np.stack(actions)


def _name(policy: Policy) -> str:
    return f"policy {type(policy).__name__}"
