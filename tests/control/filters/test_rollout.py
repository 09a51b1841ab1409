import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.filters.rollout import RolloutPlanner
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import WITHIN
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import yaw
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

NEAR = {"horizon": 2.0, "replan_interval": 1.0, "num_samples": 8}


class Still:
    """Leaves the base where it is, and counts the rows of its calls."""

    def __init__(self, size):
        self.size, self.asked = size, []

    def act(self, policy_input):
        self.asked.append(len(policy_input.observation))
        return np.zeros((len(policy_input.observation), self.size))


def world_of(robot, task="ggr_restricted", **parameters):
    filters = (PluginSpec("rollout_planner", parameters),) if parameters else ()
    config = WorldConfig(max_failures=99, filters=filters)
    return World(load_robot(robot), load_task(task, {}), config, seed=3)


def run(robot, policy, task="ggr_restricted", episodes=8, first=0, **parameters):
    world = world_of(robot, task, **parameters)
    return run_episodes(world, load_policy(policy, world.robot), episodes, first=first)


def planner_of(world, policy, rows=4, **parameters):
    world.loop.set_policy(policy)
    world.start(range(rows))
    planner = RolloutPlanner(**parameters)
    planner.reset(world.loop, np.arange(rows))
    return planner


def test_fewer_failures_than_the_policy_alone():
    alone, ahead = (run("tiago", "follow_ee", **given) for given in ({}, NEAR))
    assert ahead.failures.sum() < 0.8 * alone.failures.sum()
    assert (ahead.failures == 0).sum() > (alone.failures == 0).sum()


@pytest.mark.slow
def test_jump_cost_leads_to_fewer_jumps():
    free, dear = (run("tiago", "pretrained", "door", 6, **NEAR, jump_cost=c) for c in (0.0, 0.1))
    assert dear.joint_jumps.sum() < free.joint_jumps.sum()
    assert dear.failures.sum() <= free.failures.sum()


def test_deviation_cost_leads_to_fewer_deviations():
    given = {"episodes": 4, "first": 8, **NEAR}
    free, dear = (run("hsr", "follow_ee_feedback", **given, deviation_cost=c) for c in (0.0, 0.1))
    assert (dear.max_deviation > WITHIN).sum() < (free.max_deviation > WITHIN).sum()
    assert dear.failures.sum() <= free.failures.sum()


def test_no_offset_where_the_policy_does_not_fail():
    world = world_of("pr2")
    policy = Still(3)
    planner = planner_of(world, policy, horizon=0.1, replan_interval=0.1, num_samples=8)
    command = planner(np.zeros((4, 3)), world.loop.policy_input)
    np.testing.assert_array_equal(command, np.zeros((4, 3)))
    assert policy.asked == [4]


def test_offsets_do_not_depend_on_other_rows_and_aborted_rollouts(monkeypatch):
    world = world_of("tiago")
    planner = planner_of(world, load_policy("follow_ee", world.robot), 12, num_samples=16)
    short = planner.plan(planner._now(), np.arange(12))
    for row in range(12):
        alone = planner.plan(planner._now(), np.array([row]))
        np.testing.assert_array_equal(alone[0], short[row])
    rollout = planner._rollout

    def to_the_end(now, rows, offsets, limit):
        return rollout(now, rows, offsets, np.full(len(rows), np.inf))

    monkeypatch.setattr(planner, "_rollout", to_the_end)
    np.testing.assert_array_equal(short, planner.plan(planner._now(), np.arange(12)))
    assert short.any()


def test_new_episodes_begin_without_an_offset():
    planner = planner_of(world_of("hsr"), Still(3), **NEAR)
    planner.offset[:] = 1.0
    planner.reset(planner._loop, np.array([1, 3]))
    assert planner.offset.any(axis=1).tolist() == [True, False, True, False]


def test_rollouts_are_those_of_the_policy_now():
    world, policies = world_of("hsr"), [Still(3), Still(3)]
    planner = planner_of(world, policies[0], **NEAR)
    for policy in policies:
        world.loop.set_policy(policy)
        planner.reset(world.loop, np.arange(4))
        planner.plan(planner._now(), np.arange(4))
    assert all(policy.asked for policy in policies)


def test_needs_a_policy_without_a_state():
    class Recurrent(Still):
        def reset(self, loop, rows):
            pass

    world = world_of("hsr", **NEAR)
    with pytest.raises(KinfeasError, match="rollout_planner"):
        world.start([0])
    world.loop.set_policy(Recurrent(3))
    with pytest.raises(KinfeasError, match="rollout_planner"):
        world.start([0])


def test_offsets_take_the_base_out_of_the_way_of_solids():
    world = world_of("pr2")
    planner = planner_of(world, Still(3), horizon=0.8, num_samples=8)
    rows = np.arange(4)
    free = ~planner.plan(world.loop.kinematic_state(), rows).any(axis=1)
    assert free.any()
    ahead, solids = yaw(world.loop.state.base_pose), Solids.empty(4, 1)
    ahead = np.stack([np.cos(ahead), np.sin(ahead)], axis=1)
    # Low, so that the arm is above it, and in contact after 0.3 s.
    solids.pose[:, 0, :2] = world.loop.state.base_pose[:, :2] + (0.334 + 0.05 + 0.03) * ahead
    solids.size[:, 0], solids.cylinder[:] = [0.05, 0.05, 0.0, 0.1], True
    solids.velocity[:, 0], solids.span[:] = -0.1 * ahead, 1.0
    world.backend.place_solids(solids, rows)
    assert planner.plan(world.loop.kinematic_state(), rows)[free].any(axis=1).all()
