"""The table of a benchmark: all training seeds put together, beside the paper and the ceiling."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from kinfeas.benchmark.cells import Result
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.core.metrics import Share, wilson
from kinfeas.evaluation.paper import LEARNED, PaperFigures, paper_figures
from kinfeas.policies import pretrained
from kinfeas.robots.loading import load_robot

WORLD = "analytic"

_IN_PAPER = {"sac": LEARNED, pretrained.NAME: LEARNED}
"""Ours that the paper calls otherwise; its table is of SAC."""


@dataclass(frozen=True)
class Cell:
    """What is known of one policy of one robot on one task; shares in 0-1, distances in metres.

    Attributes:
        robot: Name of the robot.
        variant: What is different about the task; empty if nothing is.
        task: Name of the task; of a YAML file, what the file is called without its suffix.
        policy: `sac`, `td3`, `pretrained`, or a baseline; `feasibility_filter:sac` with the
            feasibility filter, `rollout_planner:sac` with the rollout planner,
            `rollout_planner:feasibility_filter:sac` with both.
        world: Where it was measured.
        seeds: How many policies, each from another training seed, it is the mean of.
        training_seeds: These seeds, as far as they are known.
        episodes_per_seed: Of each of them.
        success: Share of episodes that reach the goal without a kinematic failure.
        success_std: Standard deviation of it over the training seeds; null for one.
        success_low: Lower end of its 95 % interval, as `interval` has it.
        success_high: Upper end.
        within_5cm: Share in which the EE never strays more than 5 cm.
        within_5cm_std: As above.
        ik_failures_per_episode: Kinematic failures an episode.
        mean_deviation_m: Mean distance of the EE from where it should be.
        joint_jumps_per_episode: Steps in which an arm joint has to move faster than it can.
        ceiling: Share of the goals that some base pose reaches.
        ceiling_low: Lower end of its Wilson interval.
        ceiling_high: Upper end.
        paper_success: The paper's share; null where it has none.
        paper_within_5cm: Likewise.
    """

    robot: str
    variant: str
    task: str
    policy: str
    world: str
    seeds: int
    training_seeds: tuple[int, ...]
    episodes_per_seed: int
    success: float
    success_std: float | None
    success_low: float
    success_high: float
    within_5cm: float
    within_5cm_std: float | None
    ik_failures_per_episode: float
    mean_deviation_m: float
    joint_jumps_per_episode: float
    ceiling: float
    ceiling_low: float
    ceiling_high: float
    paper_success: float | None
    paper_within_5cm: float | None

    @property
    def group(self) -> tuple[str, str]:
        """What it stands in one table with: the cells of a robot and a variant."""
        return self.robot, self.variant

    @property
    def row(self) -> tuple[str, str]:
        """What it stands in one row of that table with: its policy, and what else is told."""
        return self.policy, ""

    @property
    def learned(self) -> bool:
        """Whether it is of a learned policy."""
        return self.policy.rpartition(":")[2] in ("sac", "td3", pretrained.NAME)


def tabulate(jobs: Sequence[Job], results: Sequence[Result]) -> list[Cell]:
    """Return the cells that results come to, in the order of the jobs.

    Args:
        jobs: Policies on tasks, and the ceiling of each task.
        results: What each of them found.
    """
    groups: dict[tuple[str, str, str, str], list[tuple[Job, Result]]] = {}
    for job, result in zip(jobs, results, strict=True):
        groups.setdefault((job.robot, job.variant, job.task, job.policy), []).append((job, result))
    ceilings = {key[:3]: group[0][1] for key, group in groups.items() if key[3] == CEILING}
    return [
        _cell(group, ceilings[key[:3]]["figures"])
        for key, group in groups.items()
        if key[3] != CEILING
    ]


def interval(shares: Sequence[float], episodes: int) -> Share:
    """Return the mean of the shares of several training seeds with a 95 % interval.

    It is the wider one of two on each side: Student's t over the seeds, which says how much a
    training more or less matters, and Wilson's for `episodes`, which says how well these episodes,
    the same for all seeds, stand for all.

    Args:
        shares: Of each training seed, 0-1.
        episodes: Of each.
    """
    mean = float(np.mean(shares))
    centre = wilson(round(mean * episodes), episodes)
    low, high = min(mean, centre.low), max(mean, centre.high)
    if len(shares) > 1:
        error = float(np.std(shares, ddof=1)) / np.sqrt(len(shares))
        half = float(stats.t.ppf(0.975, len(shares) - 1)) * error
        low, high = min(low, max(0.0, mean - half)), max(high, min(1.0, mean + half))
    return Share(mean, low, high)


def to_json(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return cells as the list that `table.json` holds."""
    return [asdict(cell) for cell in cells]


def _cell(group: Sequence[tuple[Job, Result]], ceiling: dict[str, float]) -> Cell:
    job = group[0][0]
    figures = [result["figures"] for _, result in group]
    # A variant is not what the paper measured.
    known = {} if job.variant else paper_figures(load_robot(job.robot).name, job.task)
    paper = known.get(_IN_PAPER.get(job.policy, job.policy))
    seeds = [one.training_seed for one, _ in group]
    return Cell(**common(job, figures, seeds, ceiling, paper), world=WORLD)


def common(
    job: Job,
    figures: Sequence[Mapping[str, Any]],
    training_seeds: Sequence[int | None],
    ceiling: dict[str, float],
    paper: PaperFigures | None,
) -> dict[str, Any]:
    """Return the fields of a cell that are the same in every world, by name.

    Args:
        job: Whose robot, task, policy and number of episodes it is of.
        figures: What was found of each training seed.
        training_seeds: These seeds, null where they are not known.
        ceiling: Figures of the task's ceiling.
        paper: The paper's figures, if it has any.
    """
    success = interval([found["success"] for found in figures], job.episodes)
    return {
        "robot": load_robot(job.robot).name,
        "variant": job.variant,
        "task": job.task_name,
        "policy": job.policy,
        "seeds": len(figures),
        "training_seeds": tuple(seed for seed in training_seeds if seed is not None),
        "episodes_per_seed": job.episodes,
        "success": success.value,
        "success_std": _deviation(figures, "success"),
        "success_low": success.low,
        "success_high": success.high,
        "within_5cm": mean_of(figures, "within_5cm"),
        "within_5cm_std": _deviation(figures, "within_5cm"),
        "ik_failures_per_episode": mean_of(figures, "ik_failures_per_episode"),
        "mean_deviation_m": mean_of(figures, "mean_deviation_m"),
        "joint_jumps_per_episode": mean_of(figures, "joint_jumps_per_episode"),
        "ceiling": ceiling["success"],
        "ceiling_low": ceiling["low"],
        "ceiling_high": ceiling["high"],
        "paper_success": paper.success if paper else None,
        "paper_within_5cm": paper.within_5cm if paper else None,
    }


def mean_of(figures: Sequence[Mapping[str, Any]], key: str) -> float:
    """Return the mean of a figure over the training seeds."""
    return float(np.mean([found[key] for found in figures]))


def _deviation(figures: Sequence[Mapping[str, Any]], key: str) -> float | None:
    if len(figures) < 2:
        return None
    return float(np.std([found[key] for found in figures], ddof=1))
