import json
from dataclasses import fields, replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.envs.physics import PhysicsSettings, physics_config
from kinfeas.evaluation.physics.evaluate import evaluate_physics, run_physics
from kinfeas.evaluation.physics.world import PhysicsTrial, PhysicsWorld


@pytest.fixture(scope="module")
def trial():
    robot = load_robot("tiago")
    near = ggr(distance=(0.5, 0.8))
    settings = physics_config(robot, ["world.max_seconds=4"]).world
    return PhysicsTrial(robot, near, episodes=3, seed=3, settings=settings)


@pytest.fixture(scope="module")
def policy(trial):
    return load_policy("follow_ee", trial.robot)


@pytest.fixture(scope="module")
def records(trial, policy):
    return run_physics(trial, policy)


def assert_equal(one, other):
    for entry in fields(one):
        np.testing.assert_array_equal(getattr(one, entry.name), getattr(other, entry.name))


def test_the_pr2_is_slowed_down_and_others_are_not():
    slow = {
        name: physics_config(load_robot(name)).world.slow_down for name in ("pr2", "tiago", "hsr")
    }
    assert slow == {"pr2": 2.0, "tiago": 1.0, "hsr": 1.0}


def test_the_pr2_keeps_clear_of_furniture_and_others_do_not():
    kept = {
        name: physics_config(load_robot(name)).world.min_obstacle_distance
        for name in ("pr2", "tiago", "hsr")
    }
    assert kept == {"pr2": 0.03, "tiago": 0.0, "hsr": 0.0}


def test_time_limits_are_in_motion_time():
    settings = physics_config(load_robot("pr2"), ["world.max_seconds=15"]).world
    assert settings.world.max_seconds == 15
    assert settings.execution.slow_down == 2.0


def test_what_can_be_set_is_what_results_are_told_apart_by():
    """Cells of a benchmark are found again by these keys and values."""
    told = config.to_mapping(PhysicsSettings(head_start=3.0))
    apart = (
        "slow_down",
        "head_start",
        "arm_settle_timeout",
        "feasibility_filter",
        "min_obstacle_distance",
        "objects",
    )
    assert [told[key] for key in apart] == [1.0, 3.0, 8.0, False, 0.0, True]
    rest = {"dt", "max_failures", "max_seconds", "adapters", "ik", "physics"}
    assert set(told) == rest | set(apart)


def test_processes_change_nothing(trial, policy, records):
    told = []
    assert_equal(run_physics(trial, policy, 2, told.append), records)
    assert sum(told) == 3


def test_what_happens_in_an_episode(records):
    assert np.all(records.steps > 0)
    assert np.all(records.steps <= 200)
    assert np.all(records.max_deviation >= records.mean_deviation)
    # Without objects, to reach the goal is all there is to do.
    np.testing.assert_array_equal(records.done, records.reached)
    np.testing.assert_array_equal(records.base_collisions, 0)


def test_a_head_start_lets_the_ee_stand(trial, policy):
    head_start = replace(trial.settings, head_start=4.0)
    waiting = run_physics(replace(trial, settings=head_start), policy)
    assert not waiting.reached.any()
    assert np.all(waiting.mean_deviation < 0.01)


def test_the_summary_holds_what_is_asked_for(trial, policy):
    summary = evaluate_physics(replace(trial, episodes=1), policy, "follow_ee")
    assert json.loads(json.dumps(summary)) == summary
    assert (summary["world"], summary["objects"], summary["episodes"]) == ("pybullet", True, 1)
    for key in ("success", "within_5cm", "task_success", "base_collisions", "arm_collisions"):
        assert summary[key] >= 0.0


def test_the_summary_tells_the_pace_that_adapters_have_made(trial, policy):
    adapters = (
        PluginSpec("head_start", {"seconds": 3.0}), PluginSpec("slow_down", {"factor": 2.0})
    )  # fmt: skip
    settings = replace(
        trial.settings,
        slow_down=2.0,
        feasibility_filter=True,
        min_obstacle_distance=0.05,
        max_seconds=0.1,
    )
    slower = replace(trial, episodes=1, settings=replace(settings, adapters=adapters))
    summary = evaluate_physics(slower, policy)
    told = [
        summary[key]
        for key in ("slow_down", "head_start", "feasibility_filter", "min_obstacle_distance")
    ]
    assert told == [4.0, 3.0, True, 0.05]


def test_a_room_is_there_or_not(trial, policy):
    settings = replace(trial.settings, max_seconds=0.5)
    for objects in (True, False):
        door = PhysicsTrial(
            trial.robot, load_task("door"), 1, 2, replace(settings, objects=objects)
        )
        assert not run_physics(door, policy).done.any()


def test_refuses_what_it_does_not_know(trial):
    with pytest.raises(KinfeasError, match=r"'world.slow_down' must be a number in \[1, 1000\]"):
        physics_config(trial.robot, ["world.slow_down=0.5"])
    with pytest.raises(KinfeasError, match=r"unknown key 'world.action_repeat'"):
        physics_config(trial.robot, ["world.action_repeat=3"])


@pytest.mark.parametrize("name", ["drawer", "pick_place"])
def test_an_episode_is_the_same_to_the_bit_in_any_row(name):
    robot = load_robot("hsr")
    settings = physics_config(robot, ["world.max_seconds=3"]).world
    policy, parts = load_policy("pretrained", robot), []
    for episodes in (range(3), range(2, 3)):
        trial = PhysicsTrial(robot, load_task(name), settings=settings)
        world = PhysicsWorld(trial)
        parts.append(world.run(policy, episodes))
        world.close()
    for key, values in vars(parts[0]).items():
        np.testing.assert_array_equal(values[2:], vars(parts[1])[key], err_msg=key)
