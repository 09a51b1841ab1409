from dataclasses import replace

import numpy as np
import pytest

from kinfeas.envs.episodes import Collisions, run_episodes
from kinfeas.envs.world import World, evaluation_world
from kinfeas.evaluation.evaluate import EvalConfig, run
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task


@pytest.fixture(scope="module")
def config(engine, hsr):
    world = replace(evaluation_world(engine, "hsr"), max_seconds=4.0)
    return EvalConfig(hsr, ggr(distance=(0.5, 0.8)), episodes=3, seed=3, world=world)


@pytest.fixture(scope="module")
def policy(config):
    return load_policy("follow_ee", config.robot)


def test_records(config, policy):
    records, _ = run(config, policy)
    assert np.all((records.steps > 0) & (records.steps <= 200))
    assert np.all(records.max_deviation >= records.mean_deviation)
    assert records.task_done is None  # a task without objects
    np.testing.assert_array_equal(records.base_collisions, 0)


def test_a_head_start_holds_the_ee(config, policy):
    waiting, _ = run(replace(config, world=replace(config.world, head_start=4.0)), policy)
    assert not waiting.reached.any()
    assert np.all(waiting.mean_deviation < 0.01)


def test_task_success_is_unknown_without_the_objects(config, policy):
    for objects in (True, False):
        world = replace(config.world, max_seconds=0.5, backend_parameters={"objects": objects})
        done, _ = run(EvalConfig(config.robot, load_task("door"), 1, 2, world), policy)
        assert (done.task_done is not None) == objects
        assert not objects or not done.task_done.any()


@pytest.mark.parametrize("name", ["drawer", "pick_place"])
def test_an_episode_is_the_same_to_the_bit_in_any_row(name, engine, hsr):
    config = replace(evaluation_world(engine, "hsr"), max_seconds=2.0)
    policy, parts = load_policy("pretrained", hsr), []
    for first, count in ((0, 3), (2, 1)):
        world = World(hsr, load_task(name), config, 1)
        parts.append(run_episodes(world, policy, count, first=first))
        world.close()
    for key, values in vars(parts[0]).items():
        other = vars(parts[1])[key]
        expected = values if values is None else values[2:]  # not measured in this task
        np.testing.assert_array_equal(other, expected, err_msg=key)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["hsr", "tiago", "pr2"])
@pytest.mark.parametrize("task", ["drawer", "door"])
def test_packaged_policies_do_their_tasks(robot, task, engine):
    model, world = load_robot(robot), evaluation_world(engine, robot)
    records, _ = run(
        EvalConfig(model, load_task(task), 2, 1, world), load_policy("pretrained", model)
    )
    assert records.reached.any()
    np.testing.assert_array_equal(records.task_done, records.reached)


def collisions(dt, *touched):
    counted = Collisions(1, dt)
    for bodies in touched:
        counted.add(0, set(bodies))
    return counted.count[0]


def test_flickering_contacts_are_one_collision_and_each_body_counts():
    assert collisions(0.02, (), ()) == 0
    assert collisions(0.02, *[(1,), ()] * 100) == 1
    assert collisions(0.02, (1,), (1, 2), (1,), (1, 2), (2,)) == 2
    for dt, apart in ((0.02, 25), (0.1, 5)):  # half a second
        assert collisions(dt, (1,), *[()] * (apart - 1), (1,)) == 1
        assert collisions(dt, (1,), *[()] * apart, (1,)) == 2
        assert collisions(dt, (1,), *[(2,)] * apart, (1,)) == 3
