"""Train seeds of a robot's recipe and print the training time to levels of success.

    python studies/time_to_level.py pr2 --seeds 10

The levels are 70, 80 and 90 % of the ceiling and the paper's success on `ggr`. Evaluations of 256
episodes interrupt the training every few seconds and do not count. Run it on idle cores: a run uses
two, so `--at-once 2` needs four. `--set learner.batch_size=512` changes the recipe, `--minutes 10`
its length.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from kinfeas.benchmark.table import LEARNED, paper_figures
from kinfeas.cli.options import read_settings
from kinfeas.config import Settings
from kinfeas.config.recipes import load_section
from kinfeas.core.files import read_csv
from kinfeas.core.spatial import Array
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
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
    options = parser.parse_args()
    goals = levels(options.robot)
    print("level       " + "  ".join(f"{text} ({level:.1%})" for text, level in goals.items()))
    settings = read_settings(options.set)
    curve = partial(learning_curve, options.robot, options.minutes, options.every, settings)
    numbers = range(options.first, options.first + options.seeds)
    rows, last = [], []
    with ProcessPoolExecutor(options.at_once) as pool:
        for seed, (seconds, success) in zip(numbers, pool.map(curve, numbers), strict=True):
            reached = [seconds[success >= level] for level in goals.values()]
            rows.append([times.min(initial=np.inf) for times in reached])
            last.append(success[-1])
            text = " ".join(f"{100.0 * value:.0f}" for value in success)
            print(f"seed {seed:2d}     {_seconds(rows[-1])}  {last[-1]:.1%} at the end; {text}")
    print(f"median      {_seconds(np.median(rows, axis=0))}  {np.median(last):.1%} at the end")
    print(f"worst       {_seconds(np.max(rows, axis=0))}  {min(last):.1%} at the end")


def learning_curve(
    robot: str, minutes: float, every: float, settings: Settings, seed: int
) -> tuple[Array, Array]:
    """Return the evaluations of a training by the robot's own recipe, one after `every` seconds.

    `settings` are values by key such as `learner.batch_size`. The curve is that of `evaluations`.
    """
    count = max(1, round(60.0 * minutes / every))
    schedule = {"minutes": minutes, "evaluations": count, "final_episodes": 1}
    schedule["checkpoint_seconds"] = 86400
    config = recipe_of(robot, {"seed": seed, "schedule": schedule, **settings})
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder) / "run")
        return evaluations(Path(folder) / "run")


def evaluations(run: Path) -> tuple[Array, Array]:
    """Return training seconds before each evaluation of a run, and its success in 0-1, (k,)."""
    columns = read_csv(run / "metrics.csv", ["seconds", "evaluation/success"])
    seconds, success = columns.values()
    evaluated = np.isfinite(success)
    return seconds[evaluated], success[evaluated]


def levels(robot: str) -> dict[str, float]:
    """Return levels of success on the training task: fractions of the ceiling, and the paper's."""
    model = load_robot(robot)
    ceiling = measure_reachability(model, load_task("ggr"), 500, seed=1).share.value
    values = {f"{fraction:.0%} of the ceiling": fraction * ceiling for fraction in (0.7, 0.8, 0.9)}
    paper = paper_figures(model.name, "ggr").get(LEARNED)
    return values | ({} if paper is None else {"the paper's success": paper.success})


def recipe_of(robot: str, settings: Settings) -> TrainConfig:
    """Return the training recipe of a robot, changed by settings such as `seed`."""
    return load_section(TrainConfig, "train", robot, {"robot": robot, **settings})


def _seconds(times: object) -> str:
    return " ".join(f"{time:6.0f} s" for time in np.asarray(times))


if __name__ == "__main__":
    main()
