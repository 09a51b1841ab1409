from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.benchmark.evaluations import CEILING, Evaluation
from kinfeas.benchmark.table import interval, tabulate
from kinfeas.core.metrics import wilson
from tests.benchmark.benchmark_cases import cells, result

PHYSICAL = {"base_collisions": 1.0, "arm_collisions": 0.0, "collision_free_rate": 0.5}


def cell(robot, task, policy, variant="", row=""):
    keys = ("robot", "task", "policy", "variant", "row")
    table = {tuple(getattr(entry, key) for key in keys): entry for entry in cells()}
    return table[robot, task, policy, variant, row]


def physical():
    """Return the cells of a PyBullet benchmark with two parts of a policy's episodes."""
    job = Evaluation("pr2", "pr2", "door", "pretrained", "pretrained", 100, 1)
    parts = [replace(job, backend="pybullet", first=at, episodes=20) for at in (0, 20)]
    head_start = replace(parts[0], row="head_start")
    results = [
        (replace(job, policy=CEILING), {"success": 0.9, "success_low": 0.8, "success_high": 1.0}),
        (job, result(0.75)),
        (parts[0], result(0.8, episodes=20, task_success=0.5, **PHYSICAL)),
        (parts[1], result(0.6, episodes=20, task_success=0.7, **PHYSICAL)),
        (replace(job, row="head_start"), result(0.75)),
        (head_start, result(1.0, episodes=20, task_success=1.0, head_start=3.0, **PHYSICAL)),
    ]
    return tabulate(results, "pybullet")


def test_seeds_are_averaged():
    learned = cell("pr2", "ggr", "sac")
    assert (learned.seeds, learned.training_seeds) == (3, (0, 1, 2))
    assert learned.success == pytest.approx(0.92)
    assert learned.success_std == pytest.approx(0.02)
    assert (learned.ceiling, learned.episodes_per_seed, learned.world) == (0.98, 100, "analytic")
    assert cell("pr2", "ggr", "sac", row="feasibility filter").filters == ("feasibility",)


def test_one_seed_has_wilson_s_interval():
    simple = cell("pr2", "ggr", "follow_ee")
    assert (simple.seeds, simple.training_seeds, simple.success_std) == (1, (), None)
    expected = wilson(60, 100)
    assert (simple.success_low, simple.success_high) == (expected.low, expected.high)


def test_parts_are_joined_beside_the_analytic_world():
    plain, head_start = physical()
    assert (plain.success, plain.task_success) == (pytest.approx(0.7), pytest.approx(0.6))
    assert (plain.episodes_per_seed, plain.analytic_success) == (40, 0.75)
    assert (plain.base_collisions, plain.collision_free_rate) == (1.0, 0.5)
    assert head_start.head_start == 3.0
    expected = wilson(28, 40)
    assert (plain.success_low, plain.success_high) == (expected.low, expected.high)


@given(st.lists(st.integers(0, 50).map(lambda hits: hits / 50.0), min_size=1, max_size=6))
def test_the_interval_holds_the_mean_and_no_less_than_wilson(rates):
    over_seeds = interval(rates, 50)
    exact = wilson(round(50 * over_seeds.value), 50)
    assert 0.0 <= over_seeds.low <= over_seeds.value <= over_seeds.high <= 1.0
    assert over_seeds.low <= exact.low
    assert over_seeds.high >= exact.high


def test_seeds_that_differ_widen_the_interval():
    apart, alike = interval([0.68, 0.70, 0.72], 10**6), interval([0.7, 0.7], 10_000)
    half = 4.302653 * 0.02 / 3**0.5  # Student's t of two degrees of freedom
    assert (apart.low, apart.high) == (pytest.approx(0.7 - half), pytest.approx(0.7 + half))
    assert alike.high - alike.low < 0.02
