import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.core import spatial
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

TASKS = ("joystick", "chunks", "carried")
SCALING = WorldConfig(filters=(PluginSpec("time_scaling"),))


def world(name, config=SCALING, **parameters):
    return World(load_robot("pr2"), load_task(name, {"seconds": 8.0} | parameters), config, 1)


@pytest.mark.parametrize("name", TASKS)
def test_a_stream_is_followed_to_its_end_without_failure_and_jump(name):
    records = run_episodes(world(name), load_policy("pretrained", load_robot("pr2")), 6)
    assert (records.steps == 80).all()
    assert records.success.all()
    assert not records.joint_jumps.any()
    assert records.path_length is not None
    assert (records.path_length > 0.0).all()
    assert (records.final_distance <= records.max_deviation).all()


@pytest.mark.parametrize("name", TASKS)
def test_targets_keep_their_speed_and_heights(name):
    made = world(name, seconds=9.0)
    made.start(range(8))
    inbox = made.loop.stream.inbox
    low, high = made.robot.reach.comfortable
    offset = 0.1 if name == "chunks" else 0.0
    for _ in range(80):
        before = inbox.target
        made.step(np.zeros((8, 3)))
        assert inbox.speed.max() <= 0.2 * (1.0 + 1e-9)
        assert (inbox.target[:, 2] >= np.minimum(low - offset - 0.02, before[:, 2])).all()
        assert (inbox.target[:, 2] <= np.maximum(high + offset + 0.02, before[:, 2])).all()
    assert (inbox.counts[:, 0] > 0).all()


def test_targets_move_to_the_end_at_any_time_scale():
    made = world("joystick", WorldConfig(time_scale=0.5, max_failures=99))
    made.start(range(4))
    for _ in range(79):
        assert not made.step(np.zeros((4, 3))).truncated.any()
        assert made.loop.stream.inbox.live.all() or made.loop.time[0] < 1.0
    assert made.step(np.zeros((4, 3))).truncated.all()


def test_targets_wait_for_the_head_start_of_the_ee():
    made = world("joystick", WorldConfig(head_start=2.0))
    made.start(range(4))
    for _ in range(15):
        made.step(np.zeros((4, 3)))
    ahead = spatial.distance(made.loop.stream.inbox.target, made.loop.desired)[0]
    assert ahead.max() <= 0.2 * 0.1


@pytest.mark.parametrize("name", TASKS)
def test_an_episode_is_the_same_in_any_batch_and_after_a_restore(name):
    one, many = world(name), world(name)
    one.start([3])
    many.start([1, 2])
    many.start([3], np.array([1]))
    for step in range(40):
        if step == 10:
            many.start([2], np.array([0]))  # moves no target of the other row
        if step == 20:
            kept = one.snapshot()
            one = world(name)
            one.start([0])
            one.restore(kept)
        one.step(np.full((1, 3), 0.1))
        many.step(np.full((2, 3), 0.1))
    np.testing.assert_array_equal(one.loop.desired[0], many.loop.desired[1])
