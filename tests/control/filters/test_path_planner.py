import itertools
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.filters.path_planner import PathFollower, PlanFollower, follow
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose, integrate, planar_pose, yaw
from kinfeas.core.start import stacked
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.base_path import BasePath, BasePathPlanner
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import build_subgoals
from tests.builders import assert_near


def world_of(
    robot, task="ggr_restricted", filters=("path_planner", "feasibility"), adapters=(),
    execution=None, **parameters,
):  # fmt: skip
    filters, adapters = tuple(map(PluginSpec, filters)), tuple(adapters)
    config = WorldConfig(max_failures=99, filters=filters, adapters=adapters, **execution or {})
    return World(load_robot(robot), load_task(task, parameters), config, seed=3)


def test_paths_succeed_where_the_policy_does_not():
    worlds = world_of("tiago", filters=()), world_of("tiago")
    policy = load_policy("follow_ee", worlds[0].robot)
    alone, planned = (run_episodes(world, policy, 6) for world in worlds)
    assert planned.success.sum() > alone.success.sum()
    assert planned.joint_jumps.sum() < alone.joint_jumps.sum()
    assert planned.success.sum() >= 5


def test_episodes_do_not_depend_on_each_other():
    policy = load_policy("stationary", load_robot("pr2"))
    together = run_episodes(world_of("pr2", "drawer"), policy, 2)
    alone = run_episodes(world_of("pr2", "drawer"), policy, 1, first=1)
    np.testing.assert_array_equal(together.max_deviation[1:], alone.max_deviation)
    assert alone.success.all()


def test_bases_go_to_a_better_place_in_the_head_start():
    world = world_of("pr2", execution={"head_start": 3.0})
    world.loop.set_policy(load_policy("stationary", world.robot))
    world.start([0])
    start, ee = world.loop.robots.base_pose, world.loop.sequence.desired
    for _ in range(30):
        assert world.step().outcome.feasible.all()
    assert (world.loop.sequence.desired == ee).all()
    assert not world.loop.sequence.resting.any()
    moved = np.linalg.norm((world.loop.robots.base_pose - start)[0, :2])
    assert moved > 0.05


@pytest.mark.parametrize(("finds", "seconds"), [(False, [0, 2, 6, 14]), (True, [0, 2, 4, 6, 8])])
def test_plans_fail_ever_more_rarely_but_pushed_robots_get_one_soon(monkeypatch, finds, seconds):
    world, periods, plan = world_of("pr2"), [], BasePathPlanner.plan
    world.loop.set_policy(load_policy("stationary", world.robot))
    world.start([0])

    def noted(self, *args, **options):
        periods.append(world.loop.sequence.periods[0])
        return plan(self, *args, **options) if finds else None

    monkeypatch.setattr(BasePathPlanner, "plan", noted)
    for period in range(round((seconds[-1] + 1) / world.loop.dt)):
        if finds and period % 10 == 9:
            state, push = world.loop.snapshot(), 0.1 if period % 20 == 9 else -0.1
            pushed = integrate(state["base_pose"], np.array([[push, 0, 0, 0, 0, 0]]), 1.0)
            world.loop.restore({**state, "base_pose": pushed})
        world.step()
    np.testing.assert_allclose(np.array(periods) * world.loop.dt, seconds, atol=0.15)


@pytest.mark.parametrize("late", [False, True])
def test_ees_wait_for_late_bases_beside_their_paths(late):
    lag = PluginSpec("actuator_lag", {"base": 0.1})
    world = world_of("pr2", adapters=[lag] * late)
    world.loop.set_policy(load_policy("stationary", world.robot))
    world.start([0])
    scales = [world.step().outcome.time_scale for _ in range(12)]
    assert scales[-1] == 1.0
    state = world.loop.snapshot()
    moved = planar_pose(np.array([0.03]), np.zeros(1), np.zeros(1))
    names = [name for name in state if name.endswith("base_pose")]
    world.loop.restore({**state, **{name: compose(state[name], moved) for name in names}})
    assert (world.step().outcome.time_scale < 0.8) == late


def test_with_targets_that_are_not_known_in_advance_the_policy_acts():
    policy = load_policy("follow_ee", load_robot("pr2"))
    planned, alone = (
        run_episodes(world_of("pr2", "joystick", filters, seconds=4.0), policy, 1)
        for filters in (("path_planner",), ())
    )
    np.testing.assert_array_equal(planned.max_deviation, alone.max_deviation)


@pytest.mark.parametrize("column", [0, 2, 5])
def test_a_robot_elsewhere_does_not_begin_a_plan(pr2, column):
    solver, task = IkSolver(pr2), load_task("ggr", {})
    rng = np.random.default_rng(0)
    start = task.sample(solver, rng)
    robot = np.array([*start.base_pose[:2], yaw(start.base_pose), *start.joint_positions])
    robot[column] += 0.2
    path = BasePath(np.empty((2, 7)), 1.0, 0.0, np.arange(2.0), np.tile(robot, (2, 1)), np.ones(2))
    loop = assemble(
        solver, build_subgoals(task.subgoals), AnalyticBackend(),
        filters=(PlanFollower(pr2, 0.1, path),), policy=load_policy("stationary", pr2),
    )  # fmt: skip
    loop.start(stacked([start]), [rng])
    with pytest.raises(KinfeasError, match=r"not at the start of the plan.*0\.20"):
        loop.step()


def test_a_path_that_is_found_after_its_motion_is_not_followed(pr2):
    class Executor:
        searches = 0

        def submit(self, search, *args):
            self.searches, self.future = self.searches + 1, Future()
            self.finish = lambda: self.future.set_result(search(*args))
            if self.searches == 1:
                self.finish()
            return self.future

    solver, task, executor = IkSolver(pr2), load_task("drawer", {}), Executor()
    rng = np.random.default_rng(0)
    loop = assemble(
        solver, build_subgoals(task.subgoals), AnalyticBackend(),
        filters=(PluginSpec("path_planner"),), policy=load_policy("stationary", pr2),
        executor=executor,
    )  # fmt: skip
    loop.start(stacked([task.sample(solver, rng)]), [rng])
    for period in range(1500):
        if period == 30:
            state = loop.snapshot()
            pushed = integrate(state["base_pose"], np.array([[0.08, 0, 0, 0, 0, 0]]), 1.0)
            loop.restore({**state, "base_pose": pushed})
        loop.step()
        if loop.sequence.subgoal[0] == 1:
            break
    assert executor.searches == 2
    for step in range(3):
        if step == 2:
            executor.finish()
        assert loop.step().time_scale == step // 2
        assert not loop.previous_command.any()
    loop.step()
    assert executor.searches == 3


@pytest.mark.parametrize(("name", "late", "gain"), [
    ("pr2", False, 3.0), ("pr2", True, 1.5), ("tiago", True, 1.5), ("hsr", True, 3.0),
])  # fmt: skip
def test_late_bases_return_gently_where_the_arm_makes_up_for_it(name, late, gain):
    robot, dt = load_robot(name), 0.02
    at_rest = np.concatenate([np.zeros(3), robot.home["home"]])[np.newaxis]
    path = BasePath(np.zeros((2, 7)), 1.0, 0.0, np.zeros(1), at_rest, np.ones(1))
    behind = planar_pose(np.array([-0.01]), np.zeros(1), np.zeros(1))
    period = SimpleNamespace(
        motions=SimpleNamespace(clock=np.zeros(1), clock_after=lambda seconds: seconds),
        time_scale=np.ones(1), motion_seconds=np.full(1, dt), base_pose=behind,
        motion=np.zeros((1, 9)) if late else None, posture_guide=None,
        joints=at_rest[:, 3:], command=np.zeros((1, command_size(robot.base))), changed=dict,
    )  # fmt: skip
    command = PathFollower(robot, dt)(period, {0: path})["command"]
    assert command[0, 0] * robot.base.max_velocity == pytest.approx(0.01 * gain)


@pytest.mark.parametrize(("rate", "gain"), [(0.0, 3.0), (0.2, 3.0), (0.2, 1.5)])
@pytest.mark.parametrize("name", ["hsr", "tiago"])
def test_a_base_beside_its_path_returns_to_it(name, rate, gain):
    base, dt = load_robot(name).base, 0.1
    path, speed = np.zeros((600, 3)), 0.5 * base.max_velocity * dt
    path[:, 2] = rate * dt * np.arange(600)
    path[1:, 0] = np.cumsum(speed * np.cos(path[:-1, 2]))
    path[1:, 1] = np.cumsum(speed * np.sin(path[:-1, 2]))
    pose = planar_pose(np.array([0.05]), np.array([0.1]), np.array([0.3]))
    for now, then in itertools.pairwise(path):
        command = follow(base, pose, now[np.newaxis], then[np.newaxis], dt, gain)
        assert np.abs(command).max() <= 1.0
        pose = integrate(pose, base_twist(base, pose, command, dt), dt)
    assert_near(pose, planar_pose(*path[-1:].T), 0.01, 0.03)


@pytest.mark.parametrize(("task", "filters", "expected"), [
    ("ggr", (), ["PathPlanner", "FeasibilityFilter"]),
    ("ggr", ("time_scaling", "path_planner"),
     ["FeasibilityFilter", "TimeScalingFilter", "PathPlanner"]),
    ("joystick", (), []),
])  # fmt: skip
def test_the_baseline_planner_brings_its_filters(task, filters, expected):
    world = world_of("fetch", task, filters)
    for name, kinds in (("planner", expected), ("stationary", None)):
        world.loop.set_policy(load_policy(name, world.robot))
        built = [type(command_filter).__name__ for command_filter in world.loop.filters]
        assert len(built) == len(filters) if kinds is None else built == kinds


@pytest.mark.slow
def test_the_baseline_planner_drives_an_imported_robot():
    world = world_of("lekiwi", filters=())
    records = run_episodes(world, load_policy("planner", world.robot), 3)
    assert records.success.sum() >= 2
