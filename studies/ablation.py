"""Compare variants of a robot's training recipe at equal environment steps.

    python studies/ablation.py pr2 --steps 600000 --variant learner.policy_delay=2,learner.tau=0.01

Prints a row for each variant, the recipe first: the success at each evaluation and the time of
a gradient step with its environment steps, means of the seeds.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from time_to_level import evaluations, recipe_of

from kinfeas.cli.options import read_settings
from kinfeas.config import Settings
from kinfeas.core.spatial import Array
from kinfeas.training.train import train


def curve(robot: str, settings: Settings) -> tuple[Array, float, float]:
    """Return success at each evaluation, 0-1, and ms of a step: updates, waiting."""
    config = recipe_of(robot, settings)
    with tempfile.TemporaryDirectory() as folder:
        done = train(config, Path(folder) / "run")
        _, success = evaluations(Path(folder) / "run")
    steps = done.steps / (config.num_envs * config.action_repeat)
    update, waiting = (1e3 * done.parts[part] / steps for part in ("update", "waiting"))
    return success, update, waiting


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
    options = parser.parse_args()
    schedule = {
        "schedule.steps": options.steps,
        "schedule.minutes": None,
        "schedule.evaluations": options.evaluations,
        "schedule.evaluation_episodes": options.episodes,
        "schedule.final_episodes": 1,
        "schedule.checkpoint_seconds": 86400,
    }
    for variant in [*([] if options.only else [""]), *options.variant]:
        settings = schedule | read_settings(list(filter(None, variant.split(","))))
        runs = [curve(options.robot, {**settings, "seed": seed}) for seed in range(options.seeds)]
        means = np.mean([success for success, *_ in runs], axis=0)
        update, waiting = np.mean([costs for _, *costs in runs], axis=0)
        percentages = " ".join(f"{100.0 * value:5.1f}" for value in means)
        cost = f"{update:5.2f} + {waiting:5.2f} ms"
        print(f"{percentages}  {cost}  {variant or 'recipe'}", flush=True)


if __name__ == "__main__":
    main()
