import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.benchmark.table import interval, tabulate, to_json
from kinfeas.core.metrics import wilson
from tests.benchmark.benchmark_cases import cells, findings

ASKED = {
    "robot", "task", "policy", "world", "seeds", "episodes_per_seed", "success", "success_std",
    "within_5cm", "joint_jumps_per_episode", "ceiling", "paper_success", "paper_within_5cm",
}  # fmt: skip


def cell(robot, task, policy, variant=""):
    (found,) = (
        one
        for one in cells()
        if (one.robot, one.task, one.policy, one.variant) == (robot, task, policy, variant)
    )
    return found


def test_seeds_come_together():
    learned = cell("pr2", "ggr", "sac")
    assert (learned.seeds, learned.training_seeds) == (3, (0, 1, 2))
    assert learned.success == pytest.approx(0.92)
    assert learned.success_std == pytest.approx(0.02)
    assert (learned.ceiling, learned.episodes_per_seed, learned.world) == (0.98, 100, "analytic")


def test_one_seed_has_no_deviation():
    simple = cell("pr2", "ggr", "follow_ee")
    assert (simple.seeds, simple.training_seeds, simple.success_std) == (1, (), None)
    expected = wilson(60, 100)
    assert (simple.success_low, simple.success_high) == (expected.low, expected.high)


def test_the_papers_figures_stand_beside():
    assert cell("pr2", "ggr", "sac").paper_success == 0.902
    assert cell("hsr", "ggr", "follow_ee").paper_within_5cm == 0.074
    assert cell("pr2", "door", "follow_ee").paper_success is None, "it reports demonstrated_base"
    assert cell("pr2", "ggr", "sac", "goals up to 1.4 m").paper_success is None


def test_json_holds_what_is_asked_for():
    entries = to_json(cells())
    assert len(entries) == 8
    assert all(entry.keys() >= ASKED for entry in entries)
    assert json.loads(json.dumps(entries, allow_nan=False))[0]["robot"] == "pr2"


def test_a_task_without_a_ceiling_is_a_mistake():
    jobs, results = findings()
    with pytest.raises(KeyError):
        tabulate(jobs[1:2], results[1:2])


@given(st.lists(st.integers(0, 50).map(lambda hits: hits / 50.0), min_size=1, max_size=6))
def test_the_interval_holds_the_mean_and_no_less_than_wilson(shares):
    found = interval(shares, 50)
    exact = wilson(round(50 * found.value), 50)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0
    assert found.low <= exact.low
    assert found.high >= exact.high


def test_seeds_that_differ_widen_the_interval():
    apart, alike = interval([0.5, 0.9], 10_000), interval([0.7, 0.7], 10_000)
    assert apart.high - apart.low > 0.9
    assert alike.high - alike.low < 0.02
