from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.filters.rollout import RolloutConfig, RolloutPlanner
from kinfeas.core.metrics import WITHIN
from kinfeas.envs.world import World
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.evaluation.evaluate import evaluation_world
from kinfeas.policies.loading import load_driver, load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

EPISODES = 8
NEAR = RolloutConfig(horizon=2.0, replan_interval=1.0, num_samples=8)


class Still:
    """Leaves the base where it is."""

    def __init__(self, size):
        self.size = size

    def act(self, policy_input):
        return np.zeros((len(policy_input.observation), self.size))


class Spy(Still):
    """Notes how many rows it is asked for."""

    def __init__(self, size):
        super().__init__(size)
        self.asked = []

    def act(self, policy_input):
        self.asked.append(len(policy_input.observation))
        return super().act(policy_input)


@pytest.fixture(scope="module")
def task():
    return load_task("ggr_restricted", {})


def run(robot, task, policy, episodes=EPISODES, first=0):
    world = World(robot, task, evaluation_world(), seed=3)
    return run_episodes(world, policy, episodes, first=first)


def test_fails_less_than_the_policy_alone(task):
    robot = load_robot("tiago")
    policy = load_policy("follow_ee", robot)

    alone = run(robot, task, policy)
    ahead = run(robot, task, RolloutPlanner(policy, NEAR))

    assert ahead.failures.sum() < 0.8 * alone.failures.sum()
    assert (ahead.failures == 0).sum() > (alone.failures == 0).sum()


def test_jumps_less_where_that_costs_no_failure():
    robot, door = load_robot("tiago"), load_task("door", {})
    policy = load_policy("pretrained", robot)

    careless, careful = (
        run(robot, door, RolloutPlanner(policy, replace(NEAR, jump_cost=jump_cost)))
        for jump_cost in (0.0, 0.1)
    )

    assert careful.joint_jumps.sum() < 0.8 * careless.joint_jumps.sum()
    assert careful.failures.sum() <= careless.failures.sum()


def test_strays_less_where_leeway_is_not_needed(task):
    robot = load_robot("hsr")
    policy = load_policy("follow_ee_feedback", robot)

    careless, careful = (
        run(
            robot,
            task,
            RolloutPlanner(policy, replace(NEAR, deviation_cost=deviation_cost)),
            episodes=16,
        )
        for deviation_cost in (0.0, 0.1)
    )

    assert (careful.max_deviation > WITHIN).sum() < (careless.max_deviation > WITHIN).sum()
    assert careful.failures.sum() <= careless.failures.sum()


def test_episodes_do_not_depend_on_each_other(task):
    robot = load_robot("pr2")
    policy = load_policy("follow_ee", robot)

    together = run(robot, task, RolloutPlanner(policy, NEAR), 4)
    alone = run(robot, task, RolloutPlanner(policy, NEAR), 1, first=2)

    for name in ("failures", "steps", "mean_deviation", "joint_jumps"):
        assert getattr(alone, name)[0] == getattr(together, name)[2]


def test_leaves_alone_what_will_not_fail(task):
    robot = load_robot("pr2")
    world = World(robot, task, evaluation_world(), seed=3)
    world.start([0])
    spy = Spy(world.action_size)
    ahead = RolloutPlanner(spy, RolloutConfig(horizon=0.1, replan_interval=0.1, num_samples=8))
    ahead.watch(world.loop)

    action = ahead.act(world.loop.policy_input)

    np.testing.assert_array_equal(action, np.zeros((1, world.action_size)))
    assert spy.asked == [1, 1]


def test_what_is_tried_out_does_not_yield(task, monkeypatch):
    robot = load_robot("pr2")
    world = World(robot, task, replace(evaluation_world(), feasibility_filter=True), seed=3)
    world.start([0])
    ahead = RolloutPlanner(Still(world.action_size))
    ahead.watch(world.loop)
    asked = []
    feasibility_filter = FeasibilityFilter.__call__
    monkeypatch.setattr(
        FeasibilityFilter, "__call__", lambda *args: asked.append(1) or feasibility_filter(*args)
    )
    action = ahead.act(world.loop.policy_input)
    assert not asked
    world.step(action)
    assert asked == [1]


def test_looks_widely_only_where_it_may_help(task, monkeypatch):
    robot = load_robot("pr2")
    world = World(robot, task, evaluation_world(), seed=3)
    world.start(range(4))
    ahead = RolloutPlanner(Still(world.action_size), RolloutConfig(num_samples=12))
    ahead.watch(world.loop)
    # Row 0 never fails, 1 is helped by the second deviation, 2 by the last one, 3 fails already.
    asked = []

    def outcome(now, rows, deviations, limit):
        asked.append((rows.tolist(), deviations.shape[1]))
        cost = np.where(rows == 0, 0.0, 5.0)[:, np.newaxis].repeat(deviations.shape[1], axis=1)
        if deviations.shape[1] > 1:
            cost[rows == 1, 1] = 0.0
            cost[rows == 2, -1] = 3.0 if deviations.shape[1] == 4 else 5.0
        return cost, (rows == 3)[:, np.newaxis].repeat(deviations.shape[1], axis=1)

    monkeypatch.setattr(ahead, "_try", outcome)
    deviation = ahead.act(world.loop.policy_input)

    assert asked == [([0, 1, 2, 3], 1), ([1, 2, 3], 7), ([2], 4)]
    np.testing.assert_array_equal(deviation.any(axis=1), [False, True, True, False])
    np.testing.assert_array_equal(deviation[2], np.clip(ahead._tries[-1], -1.0, 1.0))


def test_what_is_not_carried_on_would_not_have_been_chosen(task, monkeypatch):
    robot = load_robot("tiago")
    world = World(robot, task, evaluation_world(), seed=3)
    world.start(range(EPISODES))
    ahead = RolloutPlanner(load_policy("follow_ee", robot), RolloutConfig(num_samples=16))
    ahead.watch(world.loop)
    short = ahead.plan(ahead._now(), np.arange(EPISODES))
    attempt = ahead._try

    def to_the_end(now, rows, deviations, limit):
        return attempt(now, rows, deviations, np.full(len(rows), np.inf))

    monkeypatch.setattr(ahead, "_try", to_the_end)
    full = ahead.plan(ahead._now(), np.arange(EPISODES))

    np.testing.assert_array_equal(short, full)
    assert short.any()


def test_is_loaded_by_name():
    robot = load_robot("pr2")

    assert isinstance(load_driver("rollout_planner:follow_ee", robot), RolloutPlanner)
    assert not isinstance(load_driver("follow_ee", robot), RolloutPlanner)
    assert load_driver("rollout_planner:follow_ee", robot).rollout == RolloutConfig()
    assert load_driver("rollout_planner:follow_ee", robot, NEAR).rollout is NEAR
