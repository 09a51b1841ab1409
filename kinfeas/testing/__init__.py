"""Conformance checks of motion generators and policies, for tests of plugins."""

from collections.abc import Callable
from dataclasses import dataclass

from kinfeas.core.checks import CheckedMotion, ConformanceError
from kinfeas.core.errors import PLUGIN_ERRORS
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.spatial import Array
from kinfeas.testing.policies import check_policy
from kinfeas.testing.rules import RULES, Probe, run_trial
from kinfeas.testing.trial import Trial, describe

__all__ = [
    "RULES",
    "ConformanceError",
    "Finding",
    "Trial",
    "check_motion_generator",
    "check_policy",
    "examine",
]


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


def check_motion_generator(  # noqa: PLR0913 - keywords with defaults
    generator: MotionGenerator,
    *,
    target_poses: Array | None = None,
    seed: int = 0,
    duration: float = 120.0,
    dt: float = 0.1,
    max_velocity: float | None = 0.1,
    max_angular_velocity: float | None = 0.1,
) -> None:
    """Check that a generator fulfils the contract of `MotionGenerator`; takes about a second.

    The other arguments are those of `Trial`.

    Raises:
        ConformanceError: At the first violation.
    """
    trial = Trial(target_poses, seed, duration, dt, max_velocity, max_angular_velocity)
    run_trial(Probe(CheckedMotion(generator, every_step=True), trial))


def examine(
    generator: MotionGenerator,
    trial: Trial | None = None,
    name: str = "",
    on_step: Callable[[], None] | None = None,
) -> list[Finding]:
    """Return the result of each of `RULES`, in order; `on_step` is called after each step.

    Messages have the `name` of the generator, its class by default.
    """
    found: dict[str, str] = {}
    ended = False
    try:
        motion = CheckedMotion(generator, name, every_step=True)
        run_trial(Probe(motion, trial or Trial(), found), on_step)
        ended = True
    except ConformanceError as error:
        found[error.rule] = str(error)
    except PLUGIN_ERRORS as error:
        found["form"] = describe(error, f"motion generator {name or type(generator).__name__}")
    return [Finding(rule, found.get(rule), ended or rule in found) for rule in RULES]
