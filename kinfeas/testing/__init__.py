"""Conformance checks of motion generators and policies, for tests of plugins."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kinfeas.core.checks import CheckedMotion, ConformanceError
from kinfeas.core.errors import PLUGIN_ERRORS
from kinfeas.core.motion import MotionGenerator
from kinfeas.testing.policies import check_policy
from kinfeas.testing.rules import RULES, Probe, Trial, describe, run_trial

__all__ = [
    "RULES", "ConformanceError", "Finding", "Trial", "check_motion_generator", "check_policy",
    "examine",
]  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """Result of one rule.

    Attributes:
        rule: Key of `RULES`.
        broken: Description of a violation; None if none was found.
        checked: Whether the rule was checked completely; severe violations end the test.
    """

    rule: str
    broken: str | None
    checked: bool

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
