import sys
import threading
from contextlib import closing
from copy import copy

import numpy as np
import pytest

from kinfeas.control.filters.path_planner import PathPlanner
from kinfeas.control.filters.rollout import RolloutPlanner
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.envs.world import World, evaluation_world
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.planner_threads import in_threads
from kinfeas.tasks.loading import load_task

FAR = {"horizon": 10.0, "replan_interval": 0.5, "num_samples": 8}
ROWS = np.array([0])
BACKWARDS = np.array([[-0.5, 0.0, 0.0]])


class Leave:
    """A policy that drives away from the EE; in another thread it waits until it may."""

    def __init__(self):
        self.free = threading.Event()
        self.free.set()
        self.threads = []

    def __deepcopy__(self, _):
        other = copy(self)
        other.threads = self.copied = []
        return other

    def act(self, policy_input):
        self.threads.append(threading.get_ident())
        if threading.current_thread() is not threading.main_thread():
            self.free.wait(60.0)
        return np.repeat(BACKWARDS, len(policy_input.observation), axis=0)


@pytest.fixture
def policy():
    return Leave()


@pytest.fixture
def loop(policy):
    task = load_task("ggr_restricted", {})
    world = World(load_robot("pr2"), task, evaluation_world("analytic", "pr2"), seed=3)
    world.loop.set_policy(policy)
    world.start([0])
    return world.loop


@pytest.fixture
def planner(loop):
    """A planner of the loop, whose end is checked."""
    before, made = sys.getswitchinterval(), in_threads([RolloutPlanner(**FAR)])[0]
    made.reset(loop, ROWS)
    yield made
    loop.policy.free.set()
    for _ in range(2):
        made.close()
    assert sys.getswitchinterval() == before
    assert not any(thread.name.startswith("planner") for thread in threading.enumerate())


def settle(planner):
    planner._coming.exception()


def drive(planner, loop, periods):
    commands = []
    for _ in range(periods):
        commands.append(planner(BACKWARDS, loop.policy_input))
        loop.step(BACKWARDS)
    return np.concatenate(commands)


def test_finds_the_offset_that_is_found_without_a_thread(planner, loop):
    waiting = RolloutPlanner(**FAR)
    waiting.reset(loop, ROWS)
    expected = waiting(BACKWARDS, loop.policy_input)
    planner(BACKWARDS, loop.policy_input)
    settle(planner)
    np.testing.assert_array_equal(planner(BACKWARDS, loop.policy_input), expected)
    assert planner.offset.any()


def test_an_offset_ends_where_the_next_plan_is_late(planner, loop, policy):
    drive(planner, loop, 1)
    settle(planner)
    policy.free.clear()
    every = round(FAR["replan_interval"] / loop.dt)
    commands = drive(planner, loop, 2 * every)
    assert (commands[0] != BACKWARDS).any()
    np.testing.assert_array_equal(commands[-1:], BACKWARDS)


def test_the_thread_uses_a_copy_of_the_policy(planner, loop, policy):
    drive(planner, loop, 1)
    settle(planner)
    assert policy.threads == []
    assert threading.get_ident() not in policy.copied
    assert policy.copied


def test_errors_of_the_thread_are_raised_in_the_loop(planner, loop, monkeypatch):
    def fail(now, due):
        raise RuntimeError("boom")

    monkeypatch.setattr(planner, "plan", fail)
    planner(BACKWARDS, loop.policy_input)
    settle(planner)
    with pytest.raises(RuntimeError, match="boom"):
        planner(BACKWARDS, loop.policy_input)


def test_the_robot_rests_until_its_path_is_found(loop, monkeypatch):
    free, to_the_end = threading.Event(), MotionSequence.to_the_end

    def late(self, rows):
        assert free.wait(60.0)
        return to_the_end(self, rows)

    monkeypatch.setattr(MotionSequence, "to_the_end", late)
    (planner,) = in_threads([PathPlanner()])
    with closing(planner):
        planner.reset(loop, ROWS)
        loop.filters = (planner,)
        desired = loop.desired
        for _ in range(3):
            loop.step(BACKWARDS)
        np.testing.assert_array_equal(loop.desired, desired)
        assert not loop.previous_command.any()
        free.set()
        settle(planner)
        loop.step(BACKWARDS)
    assert loop.previous_command.any()
    assert (loop.desired != desired).any()
