"""The figures of the paper."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from kinfeas.config import strict_yaml
from kinfeas.config.recipes import find_recipe

TITLES = {"pr2": "PR2", "tiago": "TIAGo", "hsr": "HSR"}
"""Names of the shipped robots in tables and pictures."""

LEARNED = "policy"
"""Name of the paper's learned policy."""


@dataclass(frozen=True)
class PaperFigures:
    """The paper's fractions for one robot, task and policy, 0-1."""

    success: float
    within_5cm: float


def paper_figures(robot: str, task: str, world: str = "analytic") -> dict[str, PaperFigures]:
    """Return the paper's figures by policy; none for an unknown robot or task.

    The world is `analytic` or `physics`.
    """
    percentages = _table().get(world, {}).get(robot, {}).get(task, {})
    return {
        policy: PaperFigures(round(success / 100.0, 4), round(within / 100.0, 4))
        for policy, (success, within) in percentages.items()
    }


@cache
def _table() -> dict[str, Any]:
    return strict_yaml.read(find_recipe("benchmark/paper", "benchmark"))
