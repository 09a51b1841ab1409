"""Train seeds of a robot's recipe and print the training time to levels of success.

    python studies/time_to_level.py pr2 --seeds 10

The levels are 70, 80 and 90 % of the ceiling and the paper's success on `ggr`. Evaluations of 256
episodes interrupt the training every few seconds and do not count. Run it on idle cores: a run uses
two, so `--at-once 2` needs four. `--set learner.batch_size=512` changes the recipe, `--minutes 10`
its length.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from kinfeas.benchmark.learning_speed import LearningCurve, learning_curve, levels


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
    train = partial(_train, chosen.robot, chosen.minutes, chosen.every, chosen.set)
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


def _train(
    robot: str, minutes: float, every: float, overrides: list[str], seed: int
) -> LearningCurve:
    return learning_curve(robot, minutes, seed, every, overrides)


def _seconds(times: object) -> str:
    return " ".join(f"{time:6.0f} s" for time in np.asarray(times))


if __name__ == "__main__":
    main()
