"""Compare variants of a robot's training recipe at equal environment steps.

    python studies/ablation.py pr2 --steps 600000 --variant learner.policy_delay=2,learner.tau=0.01

Prints a row for each variant, the recipe first: the success at each evaluation and the time of
a gradient step with its environment steps, means of the seeds.
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np

from kinfeas.cli.options import read_settings
from kinfeas.config import Settings
from kinfeas.config.recipes import load_section
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import train


def curve(robot: str, settings: Settings) -> tuple[list[float], float, float]:
    """Return success at each evaluation, 0-1, and ms of a step: updates, waiting."""
    config = load_section(TrainConfig, "train", robot, {"robot": robot, **settings})
    with tempfile.TemporaryDirectory() as folder:
        done = train(config, Path(folder) / "run")
        with (Path(folder) / "run" / "metrics.csv").open(newline="", encoding="utf-8") as file:
            found = [row["evaluation/success"] for row in csv.DictReader(file)]
    steps = done.steps / (config.num_envs * config.action_repeat)
    update, waiting = (1e3 * done.parts[part] / steps for part in ("update", "waiting"))
    return [float(value) for value in found if value], update, waiting


def main() -> None:
    """Train all variants and print a row for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("robot")
    parser.add_argument("--variant", action="append", default=[], help="settings a.b=c,d=e")
    parser.add_argument("--only", action="store_true", help="without the recipe itself")
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--evaluations", type=int, default=6)
    parser.add_argument("--episodes", type=int, default=256)
    chosen = parser.parse_args()
    schedule = {
        "schedule.steps": chosen.steps,
        "schedule.minutes": None,
        "schedule.evaluations": chosen.evaluations,
        "schedule.evaluation_episodes": chosen.episodes,
        "schedule.final_episodes": 1,
        "schedule.checkpoint_seconds": 86400,
    }
    for variant in [*([] if chosen.only else [""]), *chosen.variant]:
        settings = schedule | read_settings(list(filter(None, variant.split(","))))
        runs = [curve(chosen.robot, {**settings, "seed": seed}) for seed in range(chosen.seeds)]
        means = np.mean([success for success, *_ in runs], axis=0)
        update, waiting = np.mean([costs for _, *costs in runs], axis=0)
        shares = " ".join(f"{100.0 * value:5.1f}" for value in means)
        cost = f"{update:5.2f} + {waiting:5.2f} ms"
        print(f"{shares}  {cost}  {variant or 'recipe'}", flush=True)


if __name__ == "__main__":
    main()
