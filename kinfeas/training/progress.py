"""How far a training run has come, and what a checkpoint keeps of it."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from kinfeas.config import Interval
from kinfeas.config.quantities import NotNegative
from kinfeas.training.state import Tally, checked

RECENT = 256
"""Training episodes that the reported success rate is the mean of."""


@dataclass
class Progress:
    """How far a run has come.

    Attributes:
        steps: Environment steps so far.
        seconds: Wall-clock time so far, over all parts of the run.
        share: Share of the run that is done, 0-1.
        success: Share of recent training episodes without a failure, with exploration and noise.
        best: Score of the best checkpoint, the mean of success and of the share of episodes in
            which the EE was never more than 5 cm off, 0-1; -1 before the first one.
        evaluations: How many evaluations there have been.
        recent: Of the last training episodes, whether each was without a failure.
        evaluating: Whether an evaluation begins now.
    """

    steps: int = 0
    seconds: float = 0.0
    share: float = 0.0
    success: float = float("nan")
    best: float = -1.0
    evaluations: int = 0
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    evaluating: bool = False

    def saved(self) -> dict[str, object]:
        """Return what a checkpoint keeps."""
        kept = {**vars(self), "recent": list(self.recent)}
        del kept["evaluating"]
        return kept

    def add(self, steps: int, successes: Iterable[bool]) -> None:
        """Count `steps` more, and the successes among the episodes that ended in them."""
        self.steps += steps
        self.recent.extend(successes)
        self.success = _success(self.recent)


@dataclass(frozen=True)
class _Saved:
    """What a checkpoint holds of the progress; share and success follow from the rest."""

    steps: Tally
    seconds: NotNegative
    best: Annotated[float, Interval(low=-1.0, high=1.0)]
    evaluations: Tally
    recent: tuple[bool, ...]
    share: object
    success: object


def read_progress(saved: object) -> Progress:
    """Return what `Progress.saved` returned, its share 0: that follows from the schedule.

    Raises:
        ValueError: If it is none.
    """
    kept = checked(_Saved, saved)
    recent = deque(kept.recent, maxlen=RECENT)
    return Progress(
        steps=kept.steps,
        seconds=kept.seconds,
        success=_success(recent),
        best=kept.best,
        evaluations=kept.evaluations,
        recent=recent,
    )


def _success(recent: deque[bool]) -> float:
    """Return the share of episodes without a failure, NaN before the first one has ended."""
    return float(np.mean(recent)) if recent else float("nan")
