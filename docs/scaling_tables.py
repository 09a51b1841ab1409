"""Measure the jobs of a benchmark and write the tables of docs/scaling.md.

It measures the kinds of jobs that docs/figures/scaling.json lacks; remove the file to measure all.

Each job runs twice, with a small and a large number of steps or episodes, each in a process of its
own. The difference is the cost of a step or an episode, the rest the cost of a start. Both are CPU
time, which other programs on the machine hardly change.
"""

import heapq
import json
import re
import resource
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kinfeas.benchmark.config import BenchmarkConfig, read_benchmark
from kinfeas.benchmark.evaluations import Evaluation, compute, plan_evaluations
from kinfeas.benchmark.markdown import table
from kinfeas.benchmark.runs import Run, plan_runs
from kinfeas.config.recipes import load_section
from kinfeas.evaluation.paper import TITLES
from kinfeas.jobs.training import finish
from kinfeas.training.config import TrainConfig

DOCS = Path(__file__).parent
FIGURES, PAGE = DOCS / "figures" / "scaling.json", DOCS / "scaling.md"
STUDY = "benchmark/study"
TASK = "ggr"
STEPS, EPISODES = (10_000, 40_000), (8, 40)
CORES = (1, 4, 32, 256)
SHOWN = ("training", "policy", "whole_body_qp")
"""Jobs of the table; the other baselines cost about as much as a policy."""

Costs = dict[str, dict[str, Any]]
"""CPU seconds of a unit and of a start, and memory in MB, by the name of a kind of job."""


def training_cost(robot: str, steps: int) -> tuple[float, float]:
    """Return CPU seconds and MB of a training of so many steps."""
    schedule = {"steps": steps, "minutes": "null", "evaluations": 1}
    schedule |= {"evaluation_episodes": 1, "final_episodes": 1}
    changes = [f"schedule.{key}={value}" for key, value in schedule.items()]
    with TemporaryDirectory() as folder:
        finish((load_section(TrainConfig, "train", robot, changes), Path(folder) / "run"))
    return spent()


def evaluation_cost(evaluation: Evaluation, episodes: int) -> tuple[float, float]:
    """Return CPU seconds and MB of an evaluation of so many episodes."""
    compute(replace(evaluation, episodes=episodes))
    return spent()


def spent() -> tuple[float, float]:
    """Return CPU seconds and MB of this process so far."""
    return time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def measure(benchmark: BenchmarkConfig, costs: Costs) -> None:
    """Add the missing costs of the jobs of a benchmark, on its task `ggr`, and keep each."""
    kinds: dict[str, tuple[Any, Any, tuple[int, int], str]] = {
        f"{robot}, training": (training_cost, robot, STEPS, "step") for robot in benchmark.robots
    }
    small = replace(benchmark, tasks=(TASK,), variants=(), policies="pretrained")
    for one in plan_evaluations(small, []):
        kinds[kind_of(one)] = (evaluation_cost, one, EPISODES, "episode")
    for name in [name for name in kinds if name not in costs]:
        cost, subject, sizes, unit = kinds[name]
        (few, _), (many, memory) = (alone(cost, subject, size) for size in sizes)
        each = max(0.0, many - few) / (sizes[1] - sizes[0])
        start = max(0.0, few - each * sizes[0])
        costs[name] = {"unit": unit, "each": each, "start": start, "memory": memory}
        sys.stderr.write(f"{name}: {each:.4g} s a {unit}, start {start:.1f} s, {memory:.0f} MB\n")
        FIGURES.write_text(json.dumps(costs, indent=1) + "\n")


def alone(cost: Any, *arguments: Any) -> tuple[float, float]:
    """Return a cost, measured in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        found: tuple[float, float] = pool.submit(cost, *arguments).result()
    return found


def kind_of(one: Evaluation) -> str:
    """Return the name of the costs of an evaluation."""
    same = {"sac": "policy", "td3": "policy", "pretrained": "policy"}
    policy = {**same, "demonstrated_base": "follow_ee"}.get(one.policy, one.policy)
    return ", ".join(part for part in (one.robot, policy, one.row) if part)


def phases(benchmark: BenchmarkConfig, costs: Costs) -> list[list[float]]:
    """Return the CPU seconds of the trainings of a benchmark, and those of its evaluations."""
    plans = [job.description[0] for job in plan_runs(benchmark, Path("none"))]
    runs = [Run(Path(f"{one.robot}-{one.learner.algorithm}-{one.seed}"), one.robot,
                one.learner.algorithm, one.seed, TASK) for one in plans]  # fmt: skip
    trainings = [seconds(costs[f"{one.robot}, training"], one.schedule.steps or 0) for one in plans]
    evaluations = plan_evaluations(benchmark, runs)
    return [trainings, [seconds(costs[kind_of(one)], one.episodes) for one in evaluations]]


def seconds(cost: dict[str, Any], units: int) -> float:
    """Return the CPU seconds of a job."""
    return float(cost["start"] + units * cost["each"])


def makespan(jobs: Iterable[float], cores: int) -> float:
    """Return the seconds until the last of the jobs ends, the long ones first."""
    free = [0.0] * cores
    for job in sorted(jobs, reverse=True):
        heapq.heapreplace(free, free[0] + job)
    return max(free)


def needs_table(costs: Costs, robots: Sequence[str]) -> list[str]:
    """Return the table of the needs of one job."""
    jobs: dict[str, dict[str, dict[str, Any]]] = {}
    for name, cost in costs.items():
        robot, _, job = name.partition(", ")
        if job.split(",")[0] in SHOWN:
            jobs.setdefault(job, {})[robot] = cost
    rows = []
    for job, of_robot in sorted(jobs.items(), key=lambda one: -len(one[1])):
        minutes = []
        for robot in robots:
            size = 1_000_000 if job == "training" else 500
            each = of_robot[robot]["each"] if robot in of_robot else None
            minutes.append("" if each is None else f"{each * size / 60.0:.1f}")
        memory = max(cost["memory"] for cost in of_robot.values())
        rows.append([job, *minutes, f"{memory:,.0f}"])
    return table(["job", *(TITLES[robot] for robot in robots), "memory, MB"], rows)


def cluster_table(jobs: Sequence[Sequence[float]]) -> list[str]:
    """Return the table of the time of the whole benchmark."""
    heads = ["hours", *(f"{cores} core{'s' * (cores > 1)}" for cores in CORES)]
    names = [f"{len(jobs[0])} trainings", f"{len(jobs[1])} evaluations"]
    rows = [
        [name, *(f"{makespan(one, cores) / 3600.0:.2f}" for cores in CORES)]
        for name, one in zip(names, jobs, strict=True)
    ]
    return table(heads, rows)


def fill(page: str, costs: Costs) -> str:
    """Return the page with the tables of these costs."""
    benchmark = read_benchmark(STUDY)
    tables = {
        "needs": needs_table(costs, benchmark.robots),
        "cluster": cluster_table(phases(benchmark, costs)),
    }
    for name, lines in tables.items():
        place = re.compile(rf"(?<=<!-- {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
        assert place.search(page), name
        page = place.sub("\n".join([*lines, ""]).replace("\\", r"\\"), page, count=1)
    return page


def main() -> None:
    """Measure, and write the page."""
    costs: Costs = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
    measure(read_benchmark(STUDY), costs)
    PAGE.write_text(fill(PAGE.read_text(), costs))


if __name__ == "__main__":
    main()
