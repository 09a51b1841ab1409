import sys
import threading
from copy import copy

import numpy as np
import pytest

from kinfeas.control.filters.rollout import RolloutConfig, RolloutPlanner
from kinfeas.envs.world import World, evaluation_world
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.rollout_planner_thread import RolloutPlannerThread
from kinfeas.tasks.loading import load_task

FAR = RolloutConfig(horizon=10.0, replan_interval=0.5, num_samples=8)


@pytest.fixture(autouse=True)
def closed(monkeypatch):
    """Close what a test has begun, and check that it leaves the interpreter as it was."""
    begun, watch = [], RolloutPlannerThread.watch
    before = sys.getswitchinterval()

    def note(ahead, loop):
        begun.append(ahead)
        watch(ahead, loop)

    monkeypatch.setattr(RolloutPlannerThread, "watch", note)
    yield
    for ahead in reversed(begun):
        ahead.close()
    assert sys.getswitchinterval() == before
    assert not any(thread.name.startswith("rollout_planner") for thread in threading.enumerate())


@pytest.fixture
def world():
    """Return a world in which base and EE part: the base stands, and the EE goes away."""
    world = World(load_robot("pr2"), load_task("ggr_restricted", {}), evaluation_world(), seed=3)
    world.start([0])
    return world


class Leave:
    """Drives backwards; in another thread it waits until that is open."""

    def __init__(self):
        self.open = threading.Event()
        self.open.set()
        self.owner = threading.get_ident()

    def __deepcopy__(self, _):
        return copy(self)

    def act(self, policy_input):
        if threading.get_ident() != self.owner:
            self.open.wait(10.0)
        return np.tile([-0.5, 0.0, 0.0], (len(policy_input.observation), 1))


def settle(ahead):
    """Wait until the look under way has ended."""
    ahead._coming.exception()


def drive(world, ahead, periods):
    return [
        (world.step(action := ahead.act(world.loop.policy_input)), action)[1]
        for _ in range(periods)
    ]


def test_finds_what_is_found_without_a_thread(world):
    beside, waiting = RolloutPlannerThread(Leave(), FAR), RolloutPlanner(Leave(), FAR)
    for ahead in (beside, waiting):
        ahead.watch(world.loop)
        ahead.act(world.loop.policy_input)
    settle(beside)
    np.testing.assert_array_equal(
        beside.act(world.loop.policy_input), waiting.act(world.loop.policy_input)
    )
    assert beside.deviation.any()


def test_the_policy_acts_alone_until_there_is_an_answer(world):
    policy = Leave()
    policy.open.clear()
    ahead = RolloutPlannerThread(policy, FAR)
    ahead.watch(world.loop)
    before = drive(world, ahead, 3)
    policy.open.set()
    settle(ahead)
    after = drive(world, ahead, 1)
    np.testing.assert_array_equal(before, np.tile([-0.5, 0.0, 0.0], (3, 1, 1)))
    assert (after[0] != before[0]).any()


def test_an_answer_that_is_late_is_not_waited_for_and_the_last_one_ends(world):
    policy = Leave()
    ahead = RolloutPlannerThread(policy, FAR)
    ahead.watch(world.loop)
    drive(world, ahead, 1)
    settle(ahead)
    policy.open.clear()
    actions = drive(world, ahead, 10)  # a look begins after five, and one is due after ten
    assert (actions[0] != [[-0.5, 0.0, 0.0]]).any()
    np.testing.assert_array_equal(drive(world, ahead, 1), [[[-0.5, 0.0, 0.0]]])
    policy.open.set()


def test_a_policy_is_asked_by_one_thread_only(world):
    class Own(Leave):
        def __deepcopy__(self, memo):
            return Own()

        def act(self, policy_input):
            self.asked_by = threading.get_ident()
            return super().act(policy_input)

    policy = Own()
    ahead = RolloutPlannerThread(policy, FAR)
    ahead.watch(world.loop)
    drive(world, ahead, 1)
    settle(ahead)
    assert policy.asked_by == threading.get_ident()
    assert ahead.rehearsed.asked_by != threading.get_ident()


def test_what_goes_wrong_in_it_is_heard_of(world, monkeypatch):
    ahead = RolloutPlannerThread(Leave(), FAR)
    ahead.watch(world.loop)

    def fail(now, due):
        raise RuntimeError("no way out")

    monkeypatch.setattr(ahead, "plan", fail)
    ahead.act(world.loop.policy_input)
    settle(ahead)
    with pytest.raises(RuntimeError, match="no way out"):
        ahead.act(world.loop.policy_input)


def test_begins_anew_with_another_loop(world):
    ahead = RolloutPlannerThread(load_policy("pretrained", load_robot("pr2")), FAR)
    ahead.watch(world.loop)
    ahead.act(world.loop.policy_input)
    other = World(load_robot("pr2"), world.task, evaluation_world(), seed=4)
    other.start([0])
    ahead.watch(other.loop)
    assert ahead._coming is None
    assert ahead.act(other.loop.policy_input).shape == (1, 3)


def test_a_loop_may_be_watched_again_after_close(world):
    ahead = RolloutPlannerThread(Leave(), FAR)
    for _ in range(2):
        ahead.watch(world.loop)
        ahead.act(world.loop.policy_input)
        settle(ahead)
        ahead.close()
        ahead.close()
