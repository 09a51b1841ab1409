"""The figures of the paper."""

from dataclasses import dataclass, field
from functools import cache

from kinfeas import config
from kinfeas.config.recipes import find_recipe

TITLES = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}
"""Names of the shipped robots in tables and pictures."""

Shares = dict[str, tuple[float, float]]
"""Success and EE deviation below 5 cm by policy, in per cent."""

LEARNED = "policy"
"""Name of the paper's learned policy."""


@dataclass(frozen=True)
class PaperTable:
    """The schema of `configs/benchmark/paper.yaml`: shares by robot and task."""

    analytic: dict[str, dict[str, Shares]] = field(default_factory=dict)
    physics: dict[str, dict[str, Shares]] = field(default_factory=dict)


@dataclass(frozen=True)
class PaperFigures:
    """The paper's shares for one robot, task and policy, in 0-1."""

    success: float
    within_5cm: float


def paper_figures(robot: str, task: str, world: str = "analytic") -> dict[str, PaperFigures]:
    """Return the paper's figures by policy; none for an unknown robot or task.

    The world is `analytic` or `physics`.
    """
    shares: Shares = getattr(_table(), world).get(robot, {}).get(task, {})
    return {
        policy: PaperFigures(round(success / 100.0, 4), round(within / 100.0, 4))
        for policy, (success, within) in shares.items()
    }


@cache
def _table() -> PaperTable:
    return config.load(PaperTable, find_recipe("benchmark/paper", "benchmark"))
