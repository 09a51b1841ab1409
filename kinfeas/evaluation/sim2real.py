"""The effect of adapters on a policy: each one alone, left out, and swept parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from kinfeas.config import PluginSpec
from kinfeas.evaluation.evaluate import Summary

Specs = tuple[PluginSpec, ...]
Evaluation = Callable[[Specs], Summary]
"""Evaluates a policy within adapters, the first one innermost."""

NONE, ALL = "none", "all"
"""Labels of the evaluations without adapters and within all of them."""


@dataclass(frozen=True)
class Cost:
    """Metrics within one adapter, `none` or `all`; or within all others, if it is left out."""

    adapter: str
    figures: Summary
    left_out: bool = False

    @property
    def label(self) -> str:
        """Name of its row."""
        return f"no {self.adapter}" if self.left_out else self.adapter


@dataclass(frozen=True)
class Axis:
    """A sweep: parameters of one adapter are set to each of the values; the title has the unit."""

    title: str
    adapter: str
    parameters: tuple[str, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class Sweep:
    """Metrics of a policy for each value of an axis."""

    axis: Axis
    figures: tuple[Summary, ...]


AXES = (
    Axis("command latency (s)", "command_latency", ("seconds",), (0.0, 0.03, 0.06, 0.12, 0.25)),
    Axis(
        "base noise (m/s and rad/s)",
        "base_noise",
        ("linear", "angular"),
        (0.0, 0.015, 0.05, 0.1, 0.15),
    ),
    Axis("head start (s)", "head_start", ("seconds",), (0.0, 1.0, 2.0, 3.0, 5.0)),
)
"""Properties of a robot that one can measure or choose."""


def measure_costs(run: Evaluation, adapters: Specs) -> list[Cost]:
    """Return the metrics without adapters, within each one alone, without each one, and within all.

    Of two adapters none is left out, which would leave the other one alone.
    """
    alone = [Cost(adapter.name, run((adapter,))) for adapter in adapters]
    others = [
        Cost(adapter.name, run(adapters[:i] + adapters[i + 1 :]), left_out=True)
        for i, adapter in enumerate(adapters)
        if len(adapters) > 2
    ]
    return [Cost(NONE, run(())), *alone, *others, Cost(ALL, run(adapters))]


def measure_sweeps(run: Evaluation, adapters: Specs, axes: Sequence[Axis] = AXES) -> list[Sweep]:
    """Return the metrics along each axis."""
    return [
        Sweep(axis, tuple(run(with_value(adapters, axis, value)) for value in axis.values))
        for axis in axes
    ]


def evaluations(adapters: Specs, axes: Sequence[Axis]) -> int:
    """Return the number of evaluations of costs and sweeps together."""
    count = len(adapters)
    return count + count * (count > 2) + 2 + sum(len(axis.values) for axis in axes)


def with_value(adapters: Specs, axis: Axis, value: float) -> Specs:
    """Return adapters with the parameters of an axis at `value`.

    A missing adapter is added: noise innermost, others outermost.
    """
    numbers: dict[str, object] = dict.fromkeys(axis.parameters, value)
    if all(adapter.name != axis.adapter for adapter in adapters):
        added = PluginSpec(axis.adapter, numbers)
        return (added, *adapters) if axis.adapter == "base_noise" else (*adapters, added)
    return tuple(
        PluginSpec(adapter.name, adapter.parameters | numbers)
        if adapter.name == axis.adapter
        else adapter
        for adapter in adapters
    )


def to_json(costs: Sequence[Cost], sweeps: Sequence[Sweep]) -> dict[str, object]:
    """Return all metrics as plain data."""
    return {
        "costs": [
            {"adapter": cost.adapter, "left_out": cost.left_out, **cost.figures} for cost in costs
        ],
        "sweeps": [
            {
                "adapter": sweep.axis.adapter,
                "parameters": list(sweep.axis.parameters),
                "points": [
                    {"value": value, **figures}
                    for value, figures in zip(sweep.axis.values, sweep.figures, strict=True)
                ],
            }
            for sweep in sweeps
        ],
    }
