"""Learning curves of a robot's own recipe, and the levels of success that they reach."""

import csv
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas.core import registry
from kinfeas.evaluation.paper import LEARNED, paper_figures
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.loading import load_robot

if TYPE_CHECKING:
    from kinfeas.training.config import TrainConfig


@dataclass(frozen=True)
class LearningCurve:
    """Success in the evaluations of a training run.

    Attributes:
        seconds: Wall-clock time of training before each evaluation, evaluations not included.
        success: Success of the policy, 0-1.
    """

    seconds: tuple[float, ...]
    success: tuple[float, ...]

    def time_to(self, level: float) -> float:
        """Return the seconds until an evaluation has at least `level`; inf if none has."""
        reached = (s for s, found in zip(self.seconds, self.success, strict=True) if found >= level)
        return next(reached, math.inf)


def learning_curve(
    robot: str, minutes: float, seed: int = 0, every: float = 5.0, overrides: Sequence[str] = ()
) -> LearningCurve:
    """Return the learning curve of the robot's own recipe, evaluated after `every` seconds.

    `overrides` are assignments such as `learner.batch_size=256`.
    """
    from kinfeas.training.train import train

    evaluations = max(1, round(60.0 * minutes / every))
    schedule = [f"schedule.minutes={minutes}", f"schedule.evaluations={evaluations}"]
    schedule += ["schedule.final_episodes=1", "schedule.checkpoint_seconds=86400"]
    config = recipe_of(robot, [f"seed={seed}", *schedule, *overrides])
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder) / "run")
        with (Path(folder) / "run" / "metrics.csv").open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["evaluation/success"]]
    return LearningCurve(
        tuple(float(row["seconds"]) for row in rows),
        tuple(float(row["evaluation/success"]) for row in rows),
    )


def levels(robot: str, goals: int = 500) -> dict[str, float]:
    """Return levels of success on the training task: shares of the ceiling, and the paper's."""
    known = load_robot(robot)
    task = registry.build("kinfeas.tasks", "ggr", {})
    ceiling = measure_reachability(known, task, goals, seed=1).share.value
    shares = {f"{share:.0%} of the ceiling": share * ceiling for share in (0.7, 0.8, 0.9)}
    paper = paper_figures(known.name, "ggr").get(LEARNED)
    return shares | ({} if paper is None else {"the paper's success": paper.success})


def recipe_of(robot: str, overrides: Sequence[str]) -> "TrainConfig":
    """Return the training recipe of a robot, changed by assignments such as `seed=1`."""
    from kinfeas.training.config import load_recipe

    return load_recipe(None, [f"robot={robot}", *overrides])
