"""Train seeds of a robot's recipe and print the training time to levels of success.

    python studies/time_to_level.py pr2 --seeds 10

The levels are 70, 80 and 90 % of the ceiling and the paper's success on `ggr`. Evaluations of 256
episodes interrupt the training every few seconds and do not count. Run it on idle cores: a run uses
two, so `--at-once 2` needs four. `--set learner.batch_size=512` changes the recipe, `--minutes 10`
its length.
"""

import argparse
import csv
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from kinfeas.benchmark.table import LEARNED, paper_figures
from kinfeas.cli.options import read_settings
from kinfeas.config import Settings, registry
from kinfeas.config.recipes import load_section
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train


def main() -> None:
    """Train the seeds and print a row for each, then median and worst."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("robot")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between evaluations")
    parser.add_argument("--at-once", type=int, default=1, help="seeds side by side")
    parser.add_argument("--set", action="append", default=[], help="a setting, such as a.b=c")
    chosen = parser.parse_args()
    wanted = levels(chosen.robot)
    print("level       " + "  ".join(f"{text} ({level:.1%})" for text, level in wanted.items()))
    train = partial(_train, chosen.robot, chosen.minutes, chosen.every, read_settings(chosen.set))
    numbers = range(chosen.first, chosen.first + chosen.seeds)
    rows, last = [], []
    with ProcessPoolExecutor(chosen.at_once) as pool:
        for seed, curve in zip(numbers, pool.map(train, numbers), strict=True):
            rows.append([curve.time_to(level) for level in wanted.values()])
            last.append(curve.success[-1])
            shown = " ".join(f"{100.0 * one:.0f}" for one in curve.success)
            print(f"seed {seed:2d}     {_seconds(rows[-1])}  {last[-1]:.1%} at the end; {shown}")
    print(f"median      {_seconds(np.median(rows, axis=0))}  {np.median(last):.1%} at the end")
    print(f"worst       {_seconds(np.max(rows, axis=0))}  {min(last):.1%} at the end")


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
    robot: str, minutes: float, seed: int = 0, every: float = 5.0, settings: Settings | None = None
) -> LearningCurve:
    """Return the learning curve of the robot's own recipe, evaluated after `every` seconds.

    `settings` are values by key such as `learner.batch_size`.
    """
    evaluations = max(1, round(60.0 * minutes / every))
    schedule = {"minutes": minutes, "evaluations": evaluations, "final_episodes": 1}
    schedule["checkpoint_seconds"] = 86400
    config = recipe_of(robot, {"seed": seed, "schedule": schedule, **(settings or {})})
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


def recipe_of(robot: str, settings: Settings) -> TrainConfig:
    """Return the training recipe of a robot, changed by settings such as `seed`."""
    return load_section(TrainConfig, "train", robot, {"robot": robot, **settings})


def _train(
    robot: str, minutes: float, every: float, settings: Settings, seed: int
) -> LearningCurve:
    return learning_curve(robot, minutes, seed, every, settings)


def _seconds(times: object) -> str:
    return " ".join(f"{time:6.0f} s" for time in np.asarray(times))


if __name__ == "__main__":
    main()
