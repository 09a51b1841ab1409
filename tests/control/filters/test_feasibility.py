from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.drive import action_size, base_twist
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.kinematic_step import KinematicStep
from kinfeas.core import spatial
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_jumps
from kinfeas.tasks.loading import load_task

DT, ROWS = 0.5, 64


@pytest.fixture
def scene(solver):
    """Arms anywhere, hands that are to stand still, and bases that want to drive anywhere."""
    robot, rng = solver.robot, np.random.default_rng(0)
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (ROWS, len(robot.arm)))
    base_pose = spatial.planar_pose(*rng.uniform(-3.0, 3.0, (3, ROWS)))
    desired = spatial.compose(base_pose, forward(solver.chain, joints))
    action = rng.uniform(-1.0, 1.0, (ROWS, action_size(robot.base)))
    return action, base_pose, desired, joints


def follows(solver, action, base_pose, desired, joints):
    """Return which arms are in time by IK without restarts, shape (n,)."""
    robot = solver.robot
    local = IkSolver(robot, replace(solver.options, restarts=0))
    twist = base_twist(robot.base, base_pose, action, DT)
    target = spatial.relative(desired, spatial.integrate(base_pose, twist, DT))
    arm = local.solve(target, joints, robot.max_joint_velocity * DT)
    return arm.feasible & ~joint_jumps(robot, joints, arm.joint_positions, DT)


@pytest.fixture
def feasibility_filter(solver):
    return FeasibilityFilter(KinematicStep(solver, DT))


def test_commands_that_the_arm_can_follow_are_left_alone(solver, scene, feasibility_filter):
    wanted, _ = feasibility_filter(*scene)
    able = follows(solver, *scene)
    assert 0 < able.sum() < ROWS
    as_given, _ = KinematicStep(solver, DT)(*scene)
    np.testing.assert_array_equal(wanted[able], as_given[able])


def test_the_nearest_command_that_the_arm_can_follow_is_taken(solver, scene, feasibility_filter):
    action, base_pose, *rest = scene
    twist, arm = feasibility_filter(*scene)
    others, helped = feasibility_filter.candidates, 0
    for row in np.flatnonzero(~follows(solver, *scene)):
        alone = [np.repeat(values[[row]], len(others), axis=0) for values in (base_pose, *rest)]
        able = others[follows(solver, others, *alone)]
        away = np.linalg.norm(able - action[row], axis=1)
        # Where nothing can be followed, the command stays.
        best = able[away.argmin()] if len(able) else action[row]
        expected = base_twist(solver.robot.base, base_pose[[row]], best[np.newaxis], DT)
        np.testing.assert_array_equal(twist[row], expected[0])
        helped += len(able) > 0
    assert helped > 0
    assert arm.feasible.sum() >= follows(solver, *scene).sum() + helped


def test_the_arm_is_what_ik_finds_for_the_command_that_is_taken(solver, scene, feasibility_filter):
    _, base_pose, desired, joints = scene
    twist, arm = feasibility_filter(*scene)
    target = spatial.relative(desired, spatial.integrate(base_pose, twist, DT))
    alone = solver.solve(target, joints, solver.robot.max_joint_velocity * DT)
    np.testing.assert_array_equal(arm.feasible, alone.feasible)
    np.testing.assert_array_equal(arm.joint_positions, alone.joint_positions)


def test_no_row_depends_on_the_others(scene, feasibility_filter):
    together, _ = feasibility_filter(*scene)
    apart = [
        feasibility_filter(*(values[[i]] for values in scene))[0][0] for i in range(0, ROWS, 7)
    ]
    np.testing.assert_array_equal(apart, together[::7])


def test_rows_that_stand_still_are_left_alone(solver, scene, feasibility_filter):
    paused = np.arange(ROWS) % 2 == 0
    twist, arm = feasibility_filter(*scene, paused)
    as_given, found = KinematicStep(solver, DT)(*scene)
    np.testing.assert_array_equal(twist[paused], as_given[paused])
    np.testing.assert_array_equal(arm.joint_positions[paused], found.joint_positions[paused])
    np.testing.assert_array_equal(twist[~paused], feasibility_filter(*scene)[0][~paused])


@pytest.mark.parametrize("policy", ["follow_ee_feedback", "pretrained"])
def test_an_arm_jumps_less_if_the_base_yields(policy):
    tiago, joint_jumps_of = load_robot("tiago"), []
    for feasibility_filter in (False, True):
        world = World(
            tiago, load_task("ggr"), WorldConfig(feasibility_filter=feasibility_filter), seed=1
        )
        records = run_episodes(world, load_policy(policy, tiago), 24)
        joint_jumps_of.append(records.joint_jumps.mean())
    assert joint_jumps_of[1] < 0.5 * joint_jumps_of[0]


@pytest.mark.parametrize("asks", ["world", "execution"])
def test_a_world_yields_if_it_or_its_pace_says_so(asks):
    config, execution = (
        WorldConfig(feasibility_filter=asks == "world"),
        ExecutionConfig(slow_down=2.0, feasibility_filter=asks == "execution"),
    )
    world = World(load_robot("tiago"), load_task("ggr"), config, 0, execution=execution)
    assert world.loop.execution == ExecutionConfig(slow_down=2.0, feasibility_filter=True)
