"""The results table of a benchmark: training seeds together, beside ceiling and paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy import stats

from kinfeas.benchmark.evaluations import CEILING, LEARNED_POLICIES, Evaluation
from kinfeas.config import strict_yaml
from kinfeas.config.recipes import find_recipe
from kinfeas.core.metrics import Proportion, wilson
from kinfeas.jobs.job import Result

_MEANS = (
    "success", "within_5cm", "ik_failures_per_episode", "mean_deviation_m",
    "joint_jumps_per_episode", "task_success", "base_collisions", "arm_collisions",
    "collision_free_rate",
)  # fmt: skip
"""Metrics that are means over episodes."""

LEARNED = "policy"
"""Name of the paper's learned policy in `paper.yaml`."""


@dataclass(frozen=True)
class PaperFigures:
    """The paper's fractions for one robot, task and policy, 0-1."""

    success: float
    within_5cm: float


@cache
def paper_figures(robot: str, task: str, world: str = "analytic") -> dict[str, PaperFigures]:
    """Return the paper's figures by policy; none for an unknown robot or task.

    The world is `analytic` or `physics`.
    """
    table: dict[str, Any] = strict_yaml.read(find_recipe("benchmark/paper", "benchmark"))
    return {
        policy: PaperFigures(round(success / 100.0, 4), round(within / 100.0, 4))
        for policy, (success, within) in table[world].get(robot, {}).get(task, {}).items()
    }


@dataclass(frozen=True)
class Cell:
    """Results of one policy of one robot on one task; fractions in 0-1, distances in metres."""

    robot: str
    variant: str  # label of a further table; else empty
    task: str
    policy: str
    row: str  # label of a further row of the policy; else empty
    world: str
    filters: tuple[str, ...]
    time_scale: float
    head_start: float
    seeds: int  # number of policies, each from another training seed
    training_seeds: tuple[int, ...]
    episodes_per_seed: int
    success: float  # fraction of episodes that reach the goal without an IK failure
    success_std: float | None  # standard deviation over the training seeds; null for one
    success_low: float  # lower end of the 95 % interval; see `interval`
    success_high: float
    within_5cm: float  # fraction of episodes with an EE deviation below 5 cm throughout
    within_5cm_std: float | None
    ik_failures_per_episode: float | None
    mean_deviation_m: float | None
    joint_jumps_per_episode: float
    ceiling: float  # fraction of the goals that some base pose reaches
    ceiling_low: float
    ceiling_high: float
    paper_success: float | None = None
    paper_within_5cm: float | None = None
    task_success: float | None = None
    task_success_low: float | None = None
    task_success_high: float | None = None
    base_collisions: float | None = None
    arm_collisions: float | None = None
    collision_free_rate: float | None = None
    # success in the analytic world beside physics; null without physics
    analytic_success: float | None = None
    analytic_within_5cm: float | None = None

    @property
    def learned(self) -> bool:
        """Whether the policy is a learned one."""
        return self.policy in LEARNED_POLICIES


def tabulate(results: Sequence[tuple[Evaluation, Result]], *backends: str) -> list[Cell]:
    """Return the cells of a benchmark by robot, learned policies first.

    Cells are those in the worlds `backends`; with physics, they also have the success without it.
    """
    groups: dict[tuple[str, ...], list[tuple[Evaluation, Result]]] = {}
    for case, result in results:
        key = (case.robot, case.variant, case.task, case.policy, case.row, case.backend)
        groups.setdefault(key, []).append((case, result))
    cells = []
    for (robot, variant, task, policy, row, world), group in groups.items():
        if policy == CEILING or world not in backends:
            continue
        ((_, ceiling),) = groups[robot, variant, task, CEILING, "", "analytic"]
        beside = groups.get((robot, variant, task, policy, row, "analytic"), [])
        analytic = [] if world == "analytic" else [result for _, result in beside]
        cells.append(_cell(group, ceiling, analytic))
    robots = list(dict.fromkeys(cell.robot for cell in cells))
    rows = list(dict.fromkeys((cell.policy, cell.row) for cell in cells))
    return sorted(
        cells,
        key=lambda cell: (
            robots.index(cell.robot), not cell.learned, rows.index((cell.policy, cell.row))
        ),
    )  # fmt: skip


def interval(rates: Sequence[float], episodes: int) -> Proportion:
    """Return the mean rate of several training seeds with a 95 % interval.

    Each end is that of the wider interval: Student's t over the seeds, or Wilson's for `episodes`,
    which are the same for all seeds.
    """
    mean = float(np.mean(rates))
    centre = wilson(round(mean * episodes), episodes)
    low, high = min(mean, centre.low), max(mean, centre.high)
    if len(rates) > 1:
        error = float(np.std(rates, ddof=1)) / np.sqrt(len(rates))
        half = float(stats.t.ppf(0.975, len(rates) - 1)) * error
        low, high = min(low, max(0.0, mean - half)), max(high, min(1.0, mean + half))
    return Proportion(mean, low, high)


def pooled(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the means over the episodes of all parts; None where not measured."""
    episodes = sum(part["episodes"] for part in parts)
    means: dict[str, Any] = {"episodes": episodes}
    for key in _MEANS:
        values = [part[key] for part in parts]
        complete = None not in values
        total = sum(v * part["episodes"] for v, part in zip(values, parts, strict=True) if complete)
        means[key] = total / episodes if complete else None
    return means


def _cell(
    group: Sequence[tuple[Evaluation, Result]], ceiling: Result, analytic: Sequence[Result]
) -> Cell:
    case, first = group[0]
    by_source: dict[str, list[Result]] = {}
    for case, result in group:
        by_source.setdefault(case.source, []).append(result)
    seeds = [pooled(results) for results in by_source.values()]
    episodes = seeds[0]["episodes"]
    means: dict[str, Any] = {key: _mean(seeds, key) for key in _MEANS}
    for key in ("success", "task_success"):
        if means[key] is not None:
            proportion = interval([seed[key] for seed in seeds], episodes)
            means |= {f"{key}_low": proportion.low, f"{key}_high": proportion.high}
    paper = _paper(case)
    return Cell(
        robot=case.robot_name,
        variant=case.variant,
        task=case.task_name,
        policy=case.policy,
        row=case.row,
        world=case.backend,
        filters=tuple(first["filters"]),
        time_scale=first["time_scale"],
        head_start=first["head_start"],
        seeds=len(seeds),
        training_seeds=tuple(
            sorted({case.training_seed for case, _ in group if case.training_seed is not None})
        ),
        episodes_per_seed=episodes,
        **means,
        success_std=_deviation(seeds, "success"),
        within_5cm_std=_deviation(seeds, "within_5cm"),
        ceiling=ceiling["success"],
        ceiling_low=ceiling["success_low"],
        ceiling_high=ceiling["success_high"],
        paper_success=paper.success if paper else None,
        paper_within_5cm=paper.within_5cm if paper else None,
        analytic_success=_mean(analytic, "success"),
        analytic_within_5cm=_mean(analytic, "within_5cm"),
    )


def _paper(case: Evaluation) -> PaperFigures | None:
    if case.variant:
        return None
    world = "analytic" if case.backend == "analytic" else "physics"
    figures = paper_figures(case.robot_name, case.task, world)
    if case.policy not in LEARNED_POLICIES:
        return figures.get(case.policy)
    plain = None if case.row and world == "analytic" else figures.get(LEARNED)
    return figures.get(case.row, plain)


def _mean(metrics: Sequence[Mapping[str, Any]], key: str) -> float | None:
    values = [metric[key] for metric in metrics]
    return None if not values or None in values else float(np.mean(values))


def _deviation(metrics: Sequence[Mapping[str, Any]], key: str) -> float | None:
    values = [metric[key] for metric in metrics]
    return None if len(values) < 2 else float(np.std(values, ddof=1))
