import hashlib
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kinfeas import config
from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.reward import RewardConfig
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.ggr import ggr

FAST = {"gain": 0.5, "max_velocity": 0.2, "max_angular_velocity": None}
CHAIN = config.from_mapping(
    ChainTask,
    {
        "name": "chain",
        "start": {"square": 0.5},
        "places": {"near": {"position": [[0.4, 0.6], 0.0, 0.8], "rpy": [0, [-0.5, 0.5], 0]}},
        "subgoals": [
            {"place": "near", "frame": "tip", "dwell": 0.5, "motion": {"parameters": FAST}},
            {"place": "near", "offset": [0.0, 0.1, 0.0], "motion": {"parameters": FAST}},
            {"place": "near"},
        ],
    },
    "test",
)
NOISY = WorldConfig(adapters=(PluginSpec("base_noise", {"linear": 0.05, "angular": 0.05}),))


def network(world, seed=0):
    """Return an untrained network, its actions large enough to spread the episodes."""
    rng = np.random.default_rng(seed)
    sizes = (world.observation_size, 64, 64, world.action_size)
    pairs = list(pairwise(sizes))
    return Network(
        np.ones(sizes[0], dtype=np.float32),
        tuple((rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32) for pair in pairs),
        tuple(np.zeros(pair[1], dtype=np.float32) for pair in pairs),
    )


def trace(world, episodes, steps=40, policy=None):
    """Return observations and rewards under a policy, a network's, (n, steps, 21 + j + 1)."""
    policy, found = policy or network(world), []
    world.start(episodes)
    for _ in range(steps):
        transition = world.step(policy.act(world.loop.policy_input))
        found.append(np.column_stack([transition.observation, transition.reward]))
    return np.stack(found, axis=1)


def digest(robot_name):
    """Return a hash of some noisy episodes, also printed when this file runs as a script."""
    world = World(load_robot(robot_name), ggr(), NOISY, seed=3)
    return hashlib.sha256(trace(world, range(16)).tobytes()).hexdigest()


def pretend(world, **changes):
    """Let the loop report what a test wants, for a batch of any size."""
    real = world.loop.step

    def step(action):
        n = len(action)
        seen = real(action)
        return replace(seen, **{key: np.full(n, value) for key, value in changes.items()})

    world.loop.step = step


def idle(world, n=1):
    return np.zeros((n, world.action_size))


@pytest.fixture(scope="session")
def quiet(robot):
    return World(robot, ggr(), WorldConfig(), seed=0)


@pytest.fixture
def world(robot):
    return World(robot, ggr(), WorldConfig(max_seconds=5.0), seed=0)


def test_sizes(quiet):
    joints = len(quiet.robot.arm)
    assert quiet.observation_size == 21 + joints
    assert quiet.action_size == (2 if quiet.robot.base.drive == "differential" else 3)
    assert quiet.start(range(3)).shape == (3, 21 + joints)
    transition = quiet.step(idle(quiet, 3))
    assert transition.observation.shape == (3, 21 + joints)
    for values in (transition.reward, transition.terminated, transition.truncated, transition.done):
        assert values.shape == (3,)


@pytest.mark.parametrize("size", [1, 3])
def test_an_episode_is_the_same_to_the_bit_in_any_batch(robot, size):
    world = World(robot, ggr(), NOISY, seed=3)
    together = trace(world, range(64))
    chosen = [0, 17, 63] if size == 1 else range(0, 64, 21)
    for first in chosen:
        episodes = range(first, min(first + size, 64))
        alone = trace(World(robot, ggr(), NOISY, seed=3), episodes)
        np.testing.assert_array_equal(alone, together[list(episodes)])


def test_an_episode_is_the_same_wherever_and_whenever_it_starts(robot):
    """Started late, in another row, among others."""
    world = World(robot, ggr(), NOISY, seed=3)
    expected = trace(world, range(8))
    policy = network(world)
    world.start(range(100, 105))
    for _ in range(13):
        world.step(policy.act(world.loop.policy_input))
    world.start([7, 2], np.array([4, 0]))
    for i in range(40):
        transition = world.step(policy.act(world.loop.policy_input))
        seen = np.column_stack([transition.observation, transition.reward])
        np.testing.assert_array_equal(seen[[4, 0]], expected[[7, 2], i])


def test_another_process_sees_the_same():
    names = ["pr2", "tiago", "hsr"]
    command = [sys.executable, __file__, *names]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [digest(name) for name in names]


def test_episodes_of_a_chain_are_the_same_to_the_bit_in_any_batch(robot):
    world, policy = World(robot, CHAIN, NOISY, seed=3), FollowEe(robot.base, feedback=True)
    together = trace(world, range(24), 120, policy)
    assert set(world.loop.sequence.subgoal.tolist()) == {0, 1, 2}
    for episodes in ([4], [1, 2, 3], range(20, 24)):
        alone = trace(World(robot, CHAIN, NOISY, seed=3), episodes, 120, policy)
        np.testing.assert_array_equal(alone, together[list(episodes)])


def test_goes_on_within_a_chain_to_the_bit(robot):
    world, other = (World(robot, CHAIN, NOISY, seed=3) for _ in range(2))
    policy = FollowEe(robot.base, feedback=True)
    trace(world, range(8), 60, policy)
    other.restore(world.snapshot())
    for _ in range(60):
        action = policy.act(world.loop.policy_input)
        one, two = world.step(action), other.step(action)
        np.testing.assert_array_equal(one.observation, two.observation)
        np.testing.assert_array_equal(one.done, two.done)


def test_the_time_limit_is_that_of_a_leg(robot):
    world = World(robot, CHAIN, WorldConfig(max_seconds=4.0, max_failures=999), seed=0)
    world.start([0, 1])
    real = world.loop.sequence.advance
    # The first row ends each sub-goal, wait and all, on the last step allowed, the second one none.
    for i in range(80):
        ends = np.array([i in (34, 79), False])
        world.loop.sequence.advance = lambda *_, ends=ends: real(ends)
        transition = world.step(idle(world, 2))
        assert not transition.truncated[0]
        assert transition.truncated[1] == (i >= 39)
    assert world.loop.sequence.subgoal.tolist() == [2, 0]
    assert world.steps.tolist() == [0, 80]


def test_seeds_and_episodes_differ(robot):
    first = World(robot, ggr(), WorldConfig(), seed=0).start(range(4))
    other = World(robot, ggr(), WorldConfig(), seed=1).start(range(4))
    assert len(np.unique(np.concatenate([first, other])[:, 0])) == 8


def test_noise_disturbs_the_base_alone(robot):
    plain, noisy = (World(robot, ggr(), each, seed=0) for each in (WorldConfig(), NOISY))
    np.testing.assert_array_equal(plain.start(range(4)), noisy.start(range(4)))
    for _ in range(5):
        plain.step(idle(plain, 4))
        noisy.step(idle(noisy, 4))
    np.testing.assert_array_equal(plain.loop.desired, noisy.loop.desired)
    moved = noisy.loop.state.base_pose - plain.loop.state.base_pose
    assert np.all(np.abs(moved[:, [0, 1, 5]]).max(axis=0) > 1e-4)
    np.testing.assert_array_equal(moved[:, [2, 3, 4]], 0.0)


@pytest.mark.parametrize("allowed", [0, 19, 99])
def test_more_failures_than_allowed_end_the_episode(robot, allowed):
    world = World(robot, ggr(), WorldConfig(max_failures=allowed), seed=0)
    world.start([0])
    pretend(world, feasible=False, finished=False)
    for _ in range(allowed):
        assert not world.step(idle(world)).done.any()
    last = world.step(idle(world))
    assert last.terminated.all()
    assert not last.truncated.any()
    assert not last.reached.any()
    assert world.failures == [allowed + 1]


def test_failures_need_not_follow_each_other(world):
    world.start([0])
    real = world.loop.step
    for i in range(39):
        world.loop.step = lambda action, i=i: replace(real(action), feasible=np.array([i % 2 == 1]))
        transition = world.step(idle(world))
        assert transition.terminated.all() == (i == 38)


@pytest.mark.parametrize("finished", [True, False])
def test_the_end_of_the_last_leg_is_success(world, finished):
    world.start([0, 1])
    pretend(world, finished=finished)
    transition = world.step(idle(world, 2))
    np.testing.assert_array_equal(transition.reached, finished)
    np.testing.assert_array_equal(transition.terminated, finished)
    np.testing.assert_array_equal(transition.done, finished)


def test_the_time_limit_truncates(world):
    world.start([0])
    pretend(world, feasible=True, finished=False)
    for _ in range(49):
        assert not world.step(idle(world)).done.any()
    last = world.step(idle(world))
    assert last.truncated.all()
    assert not last.terminated.any()


def test_the_time_limit_is_the_same_at_any_control_rate(robot):
    world = World(robot, ggr(), WorldConfig(dt=0.02, max_seconds=0.5), seed=0)
    world.start([0])
    pretend(world, feasible=True, finished=False)
    assert [bool(world.step(idle(world)).truncated[0]) for _ in range(25)] == [False] * 24 + [True]


@pytest.mark.parametrize("end", [{"finished": True}, {"feasible": False, "finished": False}])
def test_an_end_on_the_last_step_is_no_truncation(robot, end):
    world = World(robot, ggr(), WorldConfig(max_seconds=0.1, max_failures=0), seed=0)
    world.start([0])
    pretend(world, **({"feasible": True} | end))
    last = world.step(idle(world))
    assert last.terminated.all()
    assert not last.truncated.any()


def test_a_restart_counts_from_zero(world):
    world.start([0, 1])
    pretend(world, feasible=False, finished=False)
    for _ in range(10):
        world.step(idle(world, 2))
    world.start([2], np.array([1]))
    np.testing.assert_array_equal(world.steps, [10, 0])
    np.testing.assert_array_equal(world.failures, [10, 0])


@pytest.mark.parametrize("failure", ["indicator", "graded"])
def test_reward_is_that_of_the_step(robot, failure):
    weights = RewardConfig(failure, action_penalty=0.01, jump_penalty=0.0, limit_penalty=0.0)
    world = World(robot, ggr(), WorldConfig(reward=weights), seed=0)
    world.start([0])
    action = idle(world)
    action[:, 0] = 1.0
    pretend(world, feasible=False, position_error=0.1, rotation_error=0.0)
    cost = 1.0 if failure == "indicator" else 0.6
    np.testing.assert_allclose(world.step(action).reward, [-cost - 0.01])
    pretend(world, feasible=True, position_error=0.05, rotation_error=0.0)
    cost = 0.0 if robot.pose_tolerance is None else 0.125
    np.testing.assert_allclose(world.step(action).reward, [-cost - 0.01])


def test_a_goal_at_hand_is_reached(robot):
    """Whole episodes without a base motion: the goal lies within the arm's reach or it fails."""
    task = ggr(distance=(0.3, 0.7), heights=(0.6, 0.9))
    world = World(robot, task, WorldConfig(max_failures=99), seed=0)
    policy, n = FollowEe(robot.base, feedback=True), 24
    world.start(range(n))
    reached, done = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    for _ in range(900):
        transition = world.step(policy.act(world.loop.policy_input))
        reached |= transition.reached & ~done
        done |= transition.done
        if done.all():
            break
    # With pose tolerance, an arm may stay feasible and yet never come as near as success asks for.
    assert done.mean() >= (1.0 if robot.pose_tolerance is None else 0.9)
    assert reached.mean() > 0.2
    assert np.all(transition.reward <= 0.0)


def test_goes_on_from_a_snapshot_to_the_bit(robot):
    world = World(robot, ggr(), NOISY, seed=3)
    policy = network(world)
    world.start(range(6))
    for _ in range(10):
        world.step(policy.act(world.loop.policy_input))
    saved = world.snapshot()
    expected = [world.step(policy.act(world.loop.policy_input)) for _ in range(10)]
    counts = world.steps.copy(), world.failures.copy()
    other = World(robot, ggr(), NOISY, seed=3)
    other.restore(saved)
    for transition in expected:
        found = other.step(policy.act(other.loop.policy_input))
        np.testing.assert_array_equal(found.observation, transition.observation)
        np.testing.assert_array_equal(found.reward, transition.reward)
        np.testing.assert_array_equal(found.done, transition.done)
    np.testing.assert_array_equal(other.steps, counts[0])
    np.testing.assert_array_equal(other.failures, counts[1])


@pytest.mark.parametrize(
    ("adapter", "message"),
    [
        (PluginSpec("base_nose"), "unknown adapter 'base_nose'"),
        (PluginSpec("base_noise", {"linear": -1.0}), "linear is -1.0, must be a finite number"),
        (PluginSpec("base_noise", {"linaer": 1.0}), "unknown parameter 'linaer'"),
    ],
)
def test_wrong_adapters_are_one_sentence(robot, adapter, message):
    with pytest.raises(KinfeasError, match=message):
        World(robot, ggr(), WorldConfig(adapters=(adapter,)), seed=0)


class Foreign:
    """A task of somebody else, one array of whose episodes is not as it must be."""

    name = "foreign"
    subgoals = ggr().subgoals

    def __init__(self, name, value):
        self.changes = {name: value}

    def sample(self, solver, rng):
        return replace(ggr().sample(solver, rng), **self.changes)


@pytest.mark.parametrize(
    ("name", "value", "got"),
    [
        ("base_pose", np.zeros(3), r"a base_pose of shape \(7,\), not \(3,\)"),
        ("base_pose", [0.0] * 7, "not list"),
        (
            "joint_positions",
            np.zeros(2),
            r"a joint_positions of shape \(\d,\), not \(2,",
        ),
        ("joint_positions", None, "not NoneType"),
        ("target_poses", np.zeros(7), r"a target_poses of shape \(1, 7\), not \(7,\)"),
        ("target_poses", np.zeros((2, 7)), r"not \(2, 7\)"),
        ("target_poses", np.full((1, 7), None), r"not an array of object"),
    ],
)
def test_a_task_that_samples_other_shapes_is_named(robot, name, value, got):
    world = World(robot, Foreign(name, value), WorldConfig(), seed=0)
    with pytest.raises(KinfeasError, match=rf"^task 'foreign' must sample .*{got}"):
        world.start([0, 1])


def test_a_task_that_samples_nothing_is_named(robot, monkeypatch):
    task = Foreign("base_pose", None)
    monkeypatch.setattr(Foreign, "sample", lambda *_: None)
    with pytest.raises(KinfeasError, match=r"task 'foreign' must sample a base_pose .* NoneType"):
        World(robot, task, WorldConfig(), seed=0).start([0])


if __name__ == "__main__":
    print(*map(digest, sys.argv[1:]))  # noqa: T201
