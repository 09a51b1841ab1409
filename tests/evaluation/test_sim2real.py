import pytest

from kinfeas.config import PluginSpec
from kinfeas.evaluation.sim2real import ALL, NONE, measure_costs

ADAPTERS = (
    PluginSpec("base_noise", {"linear": 0.03}),
    PluginSpec("command_latency", {"seconds": [0.0, 0.1], "jitter": 0.02}),
)


class Runs:
    """A stand-in for an evaluation that keeps its adapters."""

    def __init__(self):
        self.adapters = []

    def __call__(self, adapters):
        self.adapters.append(tuple(adapters))
        share = 0.9 - 0.1 * len(adapters)
        return {"success": share, "success_low": share - 0.05, "success_high": share + 0.05}


def test_costs_of_each_adapter_alone_left_out_and_all():
    costs = measure_costs(Runs(), ADAPTERS)
    assert [cost.adapter for cost in costs] == [NONE, "base_noise", "command_latency", ALL]
    assert [cost.metrics["success"] for cost in costs] == pytest.approx([0.9, 0.8, 0.8, 0.7])
    three = (*ADAPTERS, PluginSpec("head_start", {}))
    costs = measure_costs(runs := Runs(), three)
    others = [cost for cost in costs if cost.left_out]
    assert [cost.label for cost in others] == [f"no {adapter.name}" for adapter in three]
    pairs = [adapters for adapters in runs.adapters if len(adapters) == 2]
    assert pairs == [(three[1], three[2]), (three[0], three[2]), (three[0], three[1])]
