import pytest

from kinfeas.config import PluginSpec
from kinfeas.evaluation.sim2real import (
    ALL,
    AXES,
    NONE,
    measure_costs,
    with_value,
)

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
    assert [cost.figures["success"] for cost in costs] == pytest.approx([0.9, 0.8, 0.8, 0.7])
    three = (*ADAPTERS, PluginSpec("head_start", {}))
    costs = measure_costs(runs := Runs(), three)
    others = [cost for cost in costs if cost.left_out]
    assert [cost.label for cost in others] == [f"no {adapter.name}" for adapter in three]
    pairs = [adapters for adapters in runs.adapters if len(adapters) == 2]
    assert pairs == [(three[1], three[2]), (three[0], three[2]), (three[0], three[1])]


def test_a_sweep_changes_one_parameter():
    latency, noise, head_start = AXES
    changed = with_value(ADAPTERS, latency, 0.25)
    assert changed[0] is ADAPTERS[0]
    assert changed[1].parameters == {"seconds": 0.25, "jitter": 0.02}
    assert ADAPTERS[1].parameters["seconds"] == [0.0, 0.1]
    # A missing adapter is added: noise innermost, others outermost.
    added = PluginSpec("base_noise", {"linear": 0.1, "angular": 0.1})
    assert with_value(ADAPTERS[1:], noise, 0.1) == (added, ADAPTERS[1])
    assert with_value(ADAPTERS[:1], latency, 0.1)[-1].name == "command_latency"
    assert with_value(ADAPTERS, head_start, 2.0)[-1] == PluginSpec("head_start", {"seconds": 2.0})
