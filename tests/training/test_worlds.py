from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.core.quantities import LAST_SEED
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.ik import IkOptions
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training import worlds
from kinfeas.training.config import TrainConfig
from kinfeas.training.worlds import EVALUATION_SEED, FRESH_SEED, training_world

EPISODES = 4


def goal(world, episode):
    """Return where an episode leads, shape (7,)."""
    world.start([episode])
    return world.loop.sequence.goal[0].copy()


def evaluated(settings, seed):
    """Return the goals of the first episodes of an evaluation, shape (4, 7)."""
    robot, task = load_robot(settings.robot), load_task(settings.task)
    world = World(robot, task, WorldConfig(), seed)
    return np.stack([goal(world, episode) for episode in range(EPISODES)])


def apart(one, other):
    """Return whether no goal of `one` is among those of `other`."""
    return not np.isclose(one[:, np.newaxis], other).all(axis=-1).any()


@pytest.mark.parametrize("seed", [0, 1, LAST_SEED])
def test_a_training_meets_none_of_the_episodes_of_its_seeds_evaluation(tiny, seed):
    settings = tiny({"seed": seed})
    learned, again = (
        np.stack([goal(training_world(settings), episode) for episode in range(EPISODES)])
        for _ in range(2)
    )
    np.testing.assert_array_equal(learned, again)
    assert apart(learned, evaluated(settings, seed))
    chosen, fresh = (evaluated(settings, seed + offset) for offset in (EVALUATION_SEED, FRESH_SEED))
    assert apart(learned, chosen)
    assert apart(learned, fresh)
    assert apart(chosen, fresh)


@pytest.mark.parametrize("backend", ["analytic", "pybullet"])
def test_an_evaluation_keeps_the_tolerances_and_filters_of_its_run(monkeypatch, backend):
    """Its adapters are the evaluation's, not those for exploration."""
    used = []
    monkeypatch.setattr(worlds, "evaluate_episodes", lambda build, *_: used.append(build.args[2]))
    ik = {"restarts": 2, "pose_tolerance": False, "position_tolerance": 1e-3}
    world = {"backend": backend, "ik": ik, "filters": ["feasibility"], "max_failures": 3}
    world["adapters"] = ["base_noise"]
    data = {"robot": "hsr", "world": world, "evaluation_adapters": ["ee_noise"]}
    settings = config.from_mapping(TrainConfig, data, "world")
    worlds.evaluate_network(settings, None, 3)
    (world,) = used
    assert world.backend == backend
    assert world.ik == IkOptions(**{**ik, "restarts": 24})
    assert [one.name for one in world.filters] == ["feasibility"]
    assert [one.name for one in world.adapters] == ["ee_noise"]
    assert world.max_failures == 99


def names(specs):
    return [spec.name for spec in specs]


def test_a_run_behind_adapters_begins_with_robots_that_respond_at_once():
    late, noise = ["domain_randomisation", "actuator_lag", "command_latency"], ["base_noise"]
    data = {"robot": "hsr", "world": {"adapters": [*noise, *late], "filters": ["feasibility"]}}
    settings = config.from_mapping(TrainConfig, data, "run")
    assert worlds.has_first_part(settings)
    first, last = (worlds.part_of(settings, analytic=part).world for part in (True, False))
    assert (names(first.adapters), names(first.filters)) == (noise, ["feasibility"])
    assert (names(last.adapters), names(last.filters)) == (
        [*noise, *late], ["feasibility", "time_scaling"],
    )  # fmt: skip
    assert not worlds.has_first_part(replace(settings, init="pretrained"))
    assert not worlds.has_first_part(replace(settings, world=first))


def test_with_a_set_response_the_ee_waits_for_the_base_behind_no_adapters_too():
    world = {"backend": "mujoco", "filters": ["feasibility"], "response": {"base_lag": 0.2}}
    settings = config.from_mapping(TrainConfig, {"robot": "hsr", "world": world}, "run")
    first, last = (worlds.part_of(settings, analytic=part).world for part in (True, False))
    assert (first.late, names(first.filters)) == (False, ["feasibility"])
    assert (last.late, names(last.filters)) == (True, ["feasibility", "time_scaling"])
    assert names(worlds.in_evaluation(settings).world.filters) == names(last.filters)
