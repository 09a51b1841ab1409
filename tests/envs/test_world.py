from dataclasses import dataclass, replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import read_sim2real
from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE, RealTimeBackend
from kinfeas.core.errors import KinfeasError, raised_by
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import relative, yaw
from kinfeas.envs.world import Batch, World, WorldConfig
from kinfeas.policies.baselines.following import FollowBase, FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.ggr import ggr
from kinfeas.tasks.loading import load_task
from tests.builders import random_network

FAST = {"generator": "minimum_jerk"}
FAST["parameters"] = {"max_velocity": 0.2, "max_angular_velocity": 0.5}
CHAIN = config.from_mapping(
    ChainTask,
    {
        "name": "chain",
        "start": {"square": 0.5},
        "places": {"near": {"position": [[0.4, 0.6], 0.0, 0.8], "rpy": [0, [-0.5, 0.5], 0]}},
        "subgoals": [
            {"place": "near", "frame": "tip", "dwell": 0.5, "motion": FAST},
            {"place": "near", "offset": [0.0, 0.1, 0.0], "motion": FAST},
            {"place": "near"},
        ],
    },
    "test",
)
SLOW = PluginSpec("time_scale", {"factor": 0.5})
NOISY = WorldConfig(adapters=(PluginSpec("base_noise", {"linear": 0.05, "angular": 0.05}),))
HARSH = WorldConfig(adapters=read_sim2real("harsh").adapters)


@dataclass(frozen=True)
class Walled:
    name: str = "walled"
    subgoals: tuple = ggr().subgoals

    def sample(self, solver, rng):
        start = ggr().sample(solver, rng)
        solids = Solids.empty(1, 1)
        turn = yaw(start.base_pose)
        solids.pose[0, 0] = [np.cos(turn), np.sin(turn), turn]
        solids.size[0, 0] = [0.1, 3.0, 0.0, 0.3]
        return replace(start, solids=solids)


def make(robot, task=None, world=NOISY, seed=3):
    return World(robot, task or ggr(), world, seed)


def trace(world, episodes, steps=40, policy=None):
    """Return observations and rewards under a policy, a network's, (n, steps, 21 + j + 1)."""
    policy, found = policy or random_network(world.robot, 64), []
    world.start(episodes)
    for _ in range(steps):
        transition = world.step(policy.act(world.loop.observation))
        found.append(np.column_stack([transition.observation, transition.reward]))
    return np.stack(found, axis=1)


def pretend(world, **changes):
    """Let the loop report what a test needs: a value for all rows, or one of each."""
    real = type(world.loop).step.__get__(world.loop)

    def step(action):
        outcome, n = real(action), len(action)
        values = {key: np.array(value) for key, value in changes.items()}
        return replace(outcome, **{k: np.resize(v, (n, *v.shape[1:])) for k, v in values.items()})

    world.loop.step = step


def idle(world, n=1):
    return np.zeros((n, world.action_size))


@pytest.fixture
def world(hsr):
    return make(hsr, world=WorldConfig(max_seconds=5.0), seed=0)


@pytest.mark.parametrize(("name", "task", "config"), [
    ("hsr", ggr(), HARSH), ("tiago", CHAIN, NOISY),
], ids=["hsr", "chain"])  # fmt: skip
def test_an_episode_is_the_same_to_the_bit_in_any_batch(name, task, config):
    robot = load_robot(name)
    world = make(robot, task, config)
    policy = random_network(robot, 64) if task is not CHAIN else FollowEe(robot.base, feedback=True)
    together = trace(world, range(24), 120, policy)
    if task is CHAIN:
        assert set(world.loop.sequence.subgoal.tolist()) == {0, 1, 2}
    for episodes in ([4], [1, 2, 3], range(20, 24)):
        alone = trace(make(robot, task, config), episodes, 120, policy)
        np.testing.assert_array_equal(alone, together[list(episodes)])


@pytest.mark.parametrize(("task", "config", "terms"), [
    (ggr(), HARSH, ()), (CHAIN, NOISY, ()),
    (Walled(), WorldConfig(), ("ee_position", "scan_low", "previous_command")),
    (load_task("ggr_dynamic"), WorldConfig(), ("ee_position", "planned_base")),
], ids=["one sub-goal", "chain", "wall", "moving solids"])  # fmt: skip
def test_a_world_continues_from_a_snapshot_to_the_bit(hsr, task, config, terms):
    world, other = (make(hsr, task, config) for _ in range(2))
    for one in (world, other):
        one.loop.observer.terms = terms or one.loop.observer.terms
    policy = FollowEe(hsr.base, feedback=True)
    trace(world, range(4), 60, policy)
    world.failures += np.arange(4)
    kept = {key: values.copy() for key, values in world.snapshot().items()}
    np.testing.assert_array_equal(other.restore(kept), world.loop.observation.values)
    for _ in range(60):
        action = policy.act(world.loop.observation)
        one, two = world.step(action), other.step(action)
        for key in ("observation", "reward", "done"):
            np.testing.assert_array_equal(getattr(one, key), getattr(two, key))
    np.testing.assert_array_equal(other.steps, world.steps)
    np.testing.assert_array_equal(other.failures, world.failures)


@pytest.mark.parametrize("allowed", [0, 19])
def test_more_failures_than_allowed_terminate_also_with_feasible_steps_between(hsr, allowed):
    world = make(hsr, world=WorldConfig(max_failures=allowed), seed=0)
    world.start([0])
    for feasible in [False, True] * allowed:
        pretend(world, feasible=feasible, finished=False)
        assert not world.step(idle(world)).done.any()
    pretend(world, feasible=False, finished=False)
    last = world.step(idle(world))
    assert (last.terminated, last.truncated, last.reached) == (True, False, False)
    assert world.failures == [allowed + 1]


def test_the_end_of_the_last_sub_goal_is_success_unless_the_base_touches(world):
    world.start(range(3))
    touched = [[True, False], [False, True], [False, False]]
    pretend(world, finished=[True, True, False], collision=touched)
    transition = world.step(idle(world, 3))
    assert transition.reached.tolist() == [False, True, False]
    assert transition.terminated.tolist() == [True, True, False]


def test_a_goal_that_is_reached_after_a_failure_is_no_success_of_a_batch(world):
    batch = Batch(world, 2)
    batch.start()
    pretend(world, feasible=[True, False], finished=False)
    batch.step(idle(world, 2))
    pretend(world, feasible=True, finished=True)
    ends = batch.step(idle(world, 2)).ends
    assert [ends[row].success for row in range(2)] == [True, False]


@pytest.mark.parametrize(("changes", "steps"), [
    ({}, 5), ({"dt": 0.02}, 25), ({"time_scale": 0.5}, 10), ({"adapters": (SLOW,)}, 10),
])  # fmt: skip
def test_the_time_limit_truncates_and_is_in_motion_time(hsr, changes, steps):
    world = make(hsr, world=WorldConfig(max_seconds=0.5, **changes), seed=0)
    world.start([0])
    pretend(world, feasible=True, finished=False)
    ends = [world.step(idle(world)) for _ in range(steps)]
    assert [bool(one.truncated[0]) for one in ends] == [False] * (steps - 1) + [True]
    assert not ends[-1].terminated.any()


def test_the_time_limit_is_that_of_a_sub_goal(hsr):
    world = make(hsr, CHAIN, WorldConfig(max_seconds=4.0, max_failures=999), seed=0)
    world.start([0, 1])
    # The first row ends each sub-goal, its dwell included, on its last step; the second one none.
    for i in range(80):
        ends = np.array([i in (34, 79), False])
        world.loop.sequence.ended = lambda _, ends=ends: ends
        transition = world.step(idle(world, 2))
        assert not transition.truncated[0]
        assert transition.truncated[1] == (i >= 39)
    assert world.loop.sequence.subgoal.tolist() == [2, 0]
    assert world.steps.tolist() == [0, 80]


@pytest.mark.parametrize("end", [(True, True), (False, False)])
def test_an_end_on_the_last_step_is_no_truncation(hsr, end):
    world = make(hsr, world=WorldConfig(max_seconds=0.1, max_failures=0), seed=0)
    world.start([0])
    pretend(world, feasible=end[0], finished=end[1])
    last = world.step(idle(world))
    assert (last.terminated, last.truncated) == (True, False)


CLOSED = []


class Closing(AnalyticBackend):
    def close(self):
        CLOSED.append(self)


class RealRobot(Closing, RealTimeBackend):
    read = stop = None


def make_real():
    return RealRobot()


@pytest.mark.parametrize(("factory", "noise", "closed"), [
    (RealRobot, 0.1, 0), (make_real, 0.1, 1), (Closing, -1.0, 1),
])  # fmt: skip
@pytest.mark.usefixtures("unregistered")
def test_real_robots_and_wrong_adapters_leave_no_backend_open(hsr, factory, noise, closed):
    CLOSED.clear()
    registry.register("kinfeas.backends", "mine", factory)
    adapters = (PluginSpec("base_noise", {"linear": noise}),)
    with pytest.raises(KinfeasError, match="linear" if noise < 0.0 else "mine"):
        make(hsr, world=WorldConfig(backend="mine", adapters=adapters))
    assert len(CLOSED) == closed


class Stuck(AnalyticBackend):
    def close(self):
        raise ConnectionError


@pytest.mark.usefixtures("unregistered")
def test_errors_of_closing_name_the_backend(hsr):
    registry.register("kinfeas.backends", "stuck", Stuck)
    with pytest.raises(ConnectionError) as caught:
        make(hsr, world=WorldConfig(backend="stuck")).close()
    assert raised_by(caught.value) == "backend Stuck"


def test_a_collision_of_the_base_ends_the_episode_without_success(hsr):
    world = make(hsr, Walled(), WorldConfig(max_failures=10**6))
    world.start(range(4))
    ahead = np.tile([1.0, 0.0, 0.0], (4, 1))
    for _ in range(200):
        before = world.loop.robots.base_pose
        transition = world.step(ahead)
        if transition.terminated.any():
            break
    assert transition.terminated.all()
    assert transition.outcome.collision[:, 0].all()
    assert not transition.reached.any()
    assert transition.reward.max() < -9.0
    # The wall's near side is 0.9 m ahead, and HSR's base has a radius of about 0.22 m.
    way = np.linalg.norm(before[:, :2], axis=1)
    assert ((way > 0.5) & (way < 0.9)).all()


def test_scans_see_the_solids_in_front(hsr):
    world = make(hsr, Walled(), WorldConfig())
    world.loop.observer.terms = ("scan_low", "scan_high")
    seen = world.start(range(3))
    low, high = seen[:, :SCAN_BEAMS], seen[:, SCAN_BEAMS:]
    np.testing.assert_allclose(low[:, SCAN_BEAMS // 2], 1.0 - 0.9 / SCAN_RANGE, atol=1e-9)
    assert (low[:, 0] == 0.0).all()
    assert (high == 0.0).all()


def test_the_planned_base_is_seen_and_its_distance_costs(hsr):
    world = World(hsr, load_task("ggr_obstacles"), WorldConfig(), 1)
    world.loop.observer.terms = ("planned_base",)
    seen = world.start(range(8))
    base = world.loop.observation.planned_base
    expected = relative(base, world.loop.robots.base_pose)
    np.testing.assert_allclose(seen[:, :2], expected[:, :2])
    assert np.isfinite(base).sum() >= 6 * 7
    along = FollowBase(hsr.base, source="planned_base")
    off = []
    for _ in range(100):
        world.step(along.act(world.loop.observation))
        off.append(world.loop.observer.base_error)
    assert np.median(off) < 0.25
    still = World(hsr, load_task("ggr"), WorldConfig(), 1)
    still.loop.observer.terms = ("planned_base",)
    assert not still.start(range(2)).any()
    still.step(np.ones((2, 3)))
    assert not still.loop.observer.base_error.any()


def test_redundant_arms_follow_their_whole_body_plan():
    robot = load_robot("tiago")
    world = World(robot, load_task("ggr_obstacles"), WorldConfig(), 1)
    world.start(range(8))
    along = FollowBase(robot.base, source="planned_base")
    for _ in range(100):
        world.step(along.act(world.loop.observation))
    planned = world.loop.sequence.planned.joints
    way = joint_displacement(robot, world.loop.robots.joint_positions, planned)
    assert np.nanmedian(np.abs(way)) < 0.1  # 0.21 where IK does not know the plan
