import json

import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.adapters import read_sim2real
from kinfeas.evaluation.sim2real import (
    ALL,
    AXES,
    NONE,
    evaluations,
    measure_costs,
    measure_sweeps,
    to_json,
    with_value,
)
from kinfeas.viz.plots import sim2real_figure
from kinfeas.viz.style import png

ADAPTERS = (
    PluginSpec("base_noise", {"linear": 0.03}),
    PluginSpec("command_latency", {"seconds": [0.0, 0.1], "jitter": 0.02}),
)


class Runs:
    """Pretends to evaluate and keeps what it was asked for."""

    def __init__(self):
        self.asked = []

    def __call__(self, adapters):
        self.asked.append(tuple(adapters))
        share = 0.9 - 0.1 * len(adapters)
        return {"success": share, "success_low": share - 0.05, "success_high": share + 0.05}


def test_costs_are_none_each_alone_and_all():
    runs = Runs()
    costs = measure_costs(runs, ADAPTERS)
    assert [cost.adapter for cost in costs] == [NONE, "base_noise", "command_latency", ALL]
    assert [len(asked) for asked in sorted(runs.asked, key=len)] == [0, 1, 1, 2]
    assert [cost.figures["success"] for cost in costs] == pytest.approx([0.9, 0.8, 0.8, 0.7])


def test_of_three_adapters_each_is_left_out_once():
    three = (*ADAPTERS, PluginSpec("head_start", {}))
    costs = measure_costs(runs := Runs(), three)
    assert len(runs.asked) == evaluations(three, ()) == len(costs)
    assert costs[-1].adapter == ALL
    others = [cost for cost in costs if cost.left_out]
    assert [cost.adapter for cost in others] == [adapter.name for adapter in three]
    assert others[0].label == "no base_noise"
    pairs = [asked for asked in runs.asked if len(asked) == 2]
    assert pairs == [(three[1], three[2]), (three[0], three[2]), (three[0], three[1])]
    assert [cost["left_out"] for cost in to_json(costs, [])["costs"]] == [
        cost.left_out for cost in costs
    ]


def test_a_sweep_changes_one_number_and_leaves_the_rest():
    latency = AXES[0]
    changed = with_value(ADAPTERS, latency, 0.25)
    assert changed[0] is ADAPTERS[0]
    assert changed[1].parameters == {"seconds": 0.25, "jitter": 0.02}
    assert ADAPTERS[1].parameters["seconds"] == [0.0, 0.1]


def test_what_is_not_there_is_added_where_a_robot_has_it():
    latency, noise, head_start = AXES
    assert with_value((), noise, 0.1) == (
        PluginSpec("base_noise", {"linear": 0.1, "angular": 0.1}),
    )
    assert with_value(ADAPTERS[1:], noise, 0.1)[0].name == "base_noise"
    assert with_value(ADAPTERS[:1], latency, 0.1)[-1].name == "command_latency"
    assert with_value(ADAPTERS, head_start, 2.0)[-1] == PluginSpec("head_start", {"seconds": 2.0})


def test_there_are_as_many_evaluations_as_is_said():
    runs = Runs()
    measure_costs(runs, ADAPTERS)
    measure_sweeps(runs, ADAPTERS)
    assert len(runs.asked) == evaluations(ADAPTERS, AXES)


def test_all_figures_are_plain_data():
    runs = Runs()
    costs, sweeps = measure_costs(runs, ADAPTERS), measure_sweeps(runs, ADAPTERS)
    data = json.loads(json.dumps(to_json(costs, sweeps)))
    assert [cost["adapter"] for cost in data["costs"]] == [cost.adapter for cost in costs]
    for sweep, axis in zip(data["sweeps"], AXES, strict=True):
        assert tuple(point["value"] for point in sweep["points"]) == axis.values
        assert {"success", "success_low"} <= sweep["points"][0].keys()


def test_axes_name_parameters_that_there_are(pr2_like):
    for axis in AXES:
        for value in axis.values:
            assert with_value(pr2_like, axis, value)


@pytest.fixture
def pr2_like():
    return read_sim2real("pr2_like").adapters


@pytest.mark.parametrize("swept", [True, False])
def test_the_picture_is_one(swept):
    runs = Runs()
    sweeps = measure_sweeps(runs, ADAPTERS) if swept else []
    figure = sim2real_figure("a policy", measure_costs(runs, ADAPTERS), sweeps)
    assert len(figure.axes) == 1 + len(sweeps)
    assert png(figure).startswith(b"\x89PNG")
