import json
import os
from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import Share, join
from kinfeas.envs.world import WorldConfig
from kinfeas.evaluation import evaluate as module
from kinfeas.evaluation.evaluate import (
    EvaluationConfig,
    Trial,
    evaluate,
    evaluation_world,
    run_trial,
    trial_reachability,
    worker_pool,
)
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr

KEYS = {
    "episodes", "success", "success_low", "success_high", "within_5cm", "ik_failures_per_episode",
    "mean_deviation_m", "joint_jumps_per_episode", "ceiling", "robot", "task", "policy", "seed",
}  # fmt: skip


@pytest.fixture(scope="module")
def trial():
    world = replace(evaluation_world(), max_seconds=6.0)
    near = ggr(distance=(0.5, 0.8))
    return Trial(load_robot("pr2"), near, episodes=20, seed=3, world=world)


@pytest.fixture(scope="module")
def policy(trial):
    return load_policy("follow_ee", trial.robot)


def test_policies_are_judged_in_an_exact_and_patient_world():
    assert evaluation_world() == replace(WorldConfig(), max_failures=99)
    assert Trial(load_robot("pr2"), ggr()).world == evaluation_world()


def test_the_summary_holds_what_is_asked_for(trial, policy):
    summary = evaluate(trial, policy, "follow_ee", Share(0.9, 0.8, 0.95))
    assert summary.keys() >= KEYS
    assert json.loads(json.dumps(summary)) == summary
    assert (summary["robot"], summary["task"], summary["policy"]) == ("pr2", "ggr", "follow_ee")
    assert (summary["episodes"], summary["seed"], summary["ceiling"]) == (20, 3, 0.9)
    assert summary["success_low"] <= summary["success"] <= summary["success_high"]


def test_without_a_ceiling_it_is_null(trial, policy):
    assert evaluate(replace(trial, episodes=2), policy)["ceiling"] is None


def test_the_same_seed_gives_the_same_figures(trial, policy):
    assert evaluate(trial, policy) == evaluate(trial, policy)
    assert evaluate(trial, policy) != evaluate(replace(trial, seed=4), policy)


def test_parts_join_to_the_whole(trial, policy):
    whole = run_trial(trial, policy)
    sizes = [8, 1, 11]
    firsts = np.cumsum([0, *sizes])
    parts = [module._run_part(trial, policy, *part) for part in zip(firsts, sizes, strict=False)]
    joined = join(parts)
    for key, values in vars(whole).items():
        np.testing.assert_array_equal(getattr(joined, key), values, err_msg=key)


@pytest.mark.slow
def test_no_figure_depends_on_the_number_of_processes(trial, policy, monkeypatch):
    monkeypatch.setattr(module, "BATCH", 11)
    done = []
    shared = evaluate(trial, policy, processes=2, on_done=done.append)
    assert shared == evaluate(trial, policy)
    assert sum(done) == trial.episodes


def test_a_worker_that_dies_is_one_sentence():
    with pytest.raises(KinfeasError, match="one of 2 worker processes died"):  # noqa: SIM117
        with worker_pool(2) as pool:
            pool.submit(os._exit, 1).result()


def test_progress_adds_up(trial, policy):
    done = []
    evaluate(trial, policy, on_done=done.append)
    assert sum(done) == trial.episodes


def test_success_stays_below_the_ceiling(trial, policy):
    assert evaluate(trial, policy)["success"] <= trial_reachability(trial).value


def test_settings():
    read = config.from_mapping(
        EvaluationConfig, {}, "settings", ["world.dt=0.05", "task.orientation=so3"]
    )
    assert read.world == replace(evaluation_world(), dt=0.05)
    assert read.task == {"orientation": "so3"}
