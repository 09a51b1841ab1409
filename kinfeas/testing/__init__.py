"""Conformance checks of motion generators and policies, for tests of plugins."""

from collections.abc import Callable
from dataclasses import dataclass

from kinfeas.core.checked_motion import CheckedMotion, ConformanceError
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
    """What became of one rule.

    Attributes:
        rule: Its short name, a key of `RULES`.
        broken: How it is broken, a sentence that names the generator; None if it was not seen to.
        checked: Whether all that belongs to it was looked at; a grave fault ends the test.
    """

    rule: str
    broken: str | None
    checked: bool

    @property
    def kept(self) -> bool:
        """Whether all was looked at and nothing found."""
        return self.checked and self.broken is None


def check_motion_generator(  # noqa: PLR0913  knobs of a test: by keyword, each with a default
    generator: MotionGenerator,
    *,
    target_poses: Array | None = None,
    seed: int = 0,
    duration: float = 120.0,
    dt: float = 0.1,
    max_velocity: float | None = 0.1,
    max_angular_velocity: float | None = 0.1,
) -> None:
    """Raise if `generator` breaks the contract of `MotionGenerator`; takes about a second.

    Args:
        generator: What to check.
        target_poses: World poses to start toward, shape (m, 7), m >= 1; 8 random ones by default.
        seed: Seed of the random poses and of the randomness that the generator is given.
        duration: Time in seconds within which every motion has to arrive.
        dt: Duration of a step in seconds.
        max_velocity: Speed that no twist may exceed, m/s; None lifts the limit.
        max_angular_velocity: Angular speed that no twist may exceed, rad/s; None lifts the limit.

    Raises:
        ConformanceError: Names the generator and the first rule it was seen to break.
    """
    trial = Trial(target_poses, seed, duration, dt, max_velocity, max_angular_velocity)
    run_trial(Probe(CheckedMotion(generator, every_step=True), trial))


def examine(
    generator: MotionGenerator,
    trial: Trial | None = None,
    name: str = "",
    on_step: Callable[[], None] | None = None,
) -> list[Finding]:
    """Return what became of each of `RULES`, in their order; `check_motion_generator` as a list.

    Args:
        generator: What to check.
        trial: What it is put to.
        name: What to call it; its class by default.
        on_step: Called after each of the trial's steps.
    """
    found: dict[str, str] = {}
    subject = f"motion generator {name or type(generator).__name__}"
    try:
        motion = CheckedMotion(generator, name, every_step=True)
        probe = Probe(motion, trial or Trial(), found)
        run_trial(probe, on_step)
        ended = True
    except ConformanceError as error:
        found[error.rule] = str(error)
        ended = False
    except PLUGIN_ERRORS as error:
        found["form"] = describe(error, subject)
        ended = False
    return [Finding(rule, found.get(rule), ended or rule in found) for rule in RULES]
