"""Time engines on the same jobs: eight trainings and an evaluation of all tasks.

python studies/engines.py [--steps 100000] [--episodes 200] [--processes 2]

Prints wall-clock seconds of one job after another, of the engine `local` and of `ray`, and their
ratios. The machine must be idle.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from kinfeas.benchmark.config import read_benchmark
from kinfeas.benchmark.evaluations import plan_evaluations
from kinfeas.config.recipes import load_section
from kinfeas.jobs.job import Job, build_engine, run_jobs, training_job
from kinfeas.training.config import TrainConfig

SEEDS = range(8)


def trainings(folder: Path, steps: int) -> list[Job]:
    """Return trainings of PR2 with a seed each."""
    schedule = {"steps": steps, "minutes": None, "evaluations": 1, "final_episodes": 64}
    recipes = [
        load_section(TrainConfig, "train", "pr2", {"schedule": schedule, "seed": seed})
        for seed in SEEDS
    ]
    return [training_job(recipe, folder / f"pr2-{recipe.seed}") for recipe in recipes]


def evaluations(folder: Path, episodes: int) -> list[Job]:
    """Return the evaluations of the packaged policies."""
    settings = {"policies": "pretrained", "episodes": episodes}
    benchmark = read_benchmark("benchmark/quick", settings)
    return [case.job(folder) for case in plan_evaluations(benchmark, [])]


def seconds(plan: Callable[[Path, int], Sequence[Job]], size: int, name: str, count: int) -> float:
    """Return the wall-clock time of jobs on an engine."""
    with TemporaryDirectory() as folder:
        jobs, begun = plan(Path(folder), size), time.perf_counter()
        run_jobs(jobs, build_engine(name, count))
        return time.perf_counter() - begun


def main() -> None:
    """Time each engine and print the ratios."""
    options = argparse.ArgumentParser(description="Time engines on the same jobs.")
    options.add_argument("--steps", type=int, default=100_000)
    options.add_argument("--episodes", type=int, default=200)
    options.add_argument("--processes", type=int, default=2)
    given = options.parse_args()
    for name, plan, size in (
        ("trainings", trainings, given.steps),
        ("evaluations", evaluations, given.episodes),
    ):
        alone = seconds(plan, size, "local", 1)
        local, ray = (seconds(plan, size, one, given.processes) for one in ("local", "ray"))
        print(
            f"{name}: one after another {alone:.0f} s; local {local:.0f} s, "
            f"{alone / local:.2f} times as fast; ray {ray:.0f} s, {ray / local - 1.0:+.0%}"
        )


if __name__ == "__main__":
    main()
