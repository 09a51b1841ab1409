"""The cost of adapters to a policy: each one alone, and each one left out."""

from collections.abc import Callable
from dataclasses import dataclass

from kinfeas.config import PluginSpec
from kinfeas.evaluation.evaluate import Summary

Specs = tuple[PluginSpec, ...]

NONE, ALL = "none", "all"
"""Labels of the evaluations without adapters and within all of them."""


@dataclass(frozen=True)
class Cost:
    """Metrics within one adapter, `none` or `all`; or within all others, if it is left out."""

    adapter: str
    metrics: Summary
    left_out: bool = False

    @property
    def label(self) -> str:
        """Name of its row."""
        return f"no {self.adapter}" if self.left_out else self.adapter


def measure_costs(run: Callable[[Specs], Summary], adapters: Specs) -> list[Cost]:
    """Return the metrics without adapters, within each one alone, without each one, and within all.

    `run` evaluates the policy within adapters, the first one innermost. Of two adapters none is
    left out, which would leave the other one alone.
    """
    alone = [Cost(adapter.name, run((adapter,))) for adapter in adapters]
    others = [
        Cost(adapter.name, run(adapters[:i] + adapters[i + 1 :]), left_out=True)
        for i, adapter in enumerate(adapters)
        if len(adapters) > 2
    ]
    return [Cost(NONE, run(())), *alone, *others, Cost(ALL, run(adapters))]
