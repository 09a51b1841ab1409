"""Measure the jobs of a benchmark and write the table of docs/scaling.md.

It measures the kinds of jobs that docs/figures/scaling.json lacks; remove the file to measure all.

Each job runs twice, with a small and a large number of steps or episodes, each in a process of its
own. The difference is the cost of a step or an episode, the rest the cost of a start. Both are CPU
time, which other programs on the machine hardly change.
"""

import json
import re
import resource
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kinfeas.benchmark.config import BenchmarkConfig, read_benchmark
from kinfeas.benchmark.evaluations import Evaluation, compute, plan_evaluations
from kinfeas.benchmark.markdown import table
from kinfeas.config.recipes import load_section
from kinfeas.evaluation.paper import TITLES
from kinfeas.jobs.training import finish
from kinfeas.training.config import TrainConfig

DOCS = Path(__file__).parent
FIGURES, PAGE = DOCS / "figures" / "scaling.json", DOCS / "scaling.md"
STUDY = "benchmark/study"
TASK = "ggr"
STEPS, EPISODES = (10_000, 40_000), (8, 40)
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
    same = {"sac": "policy", "pretrained": "policy"}
    policy = {**same, "demonstrated_base": "follow_ee"}.get(one.policy, one.policy)
    return ", ".join(part for part in (one.robot, policy, one.row) if part)


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


def fill(page: str, costs: Costs) -> str:
    """Return the page with the table of these costs."""
    lines = needs_table(costs, read_benchmark(STUDY).robots)
    place = re.compile(r"(?<=<!-- needs -->\n).*?(?=<!-- end -->)", re.DOTALL)
    assert place.search(page)
    return place.sub("\n".join([*lines, ""]).replace("\\", r"\\"), page, count=1)


def main() -> None:
    """Measure, and write the page."""
    costs: Costs = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
    measure(read_benchmark(STUDY), costs)
    PAGE.write_text(fill(PAGE.read_text(), costs))


if __name__ == "__main__":
    main()
