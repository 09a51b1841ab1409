from dataclasses import replace

import numpy as np
import pytest

from kinfeas import registry, spatial
from kinfeas.drive import action_size, base_twist
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.evaluation.policies import load_policy
from kinfeas.following import Following
from kinfeas.joints import jumps
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import Pace
from kinfeas.tasks.loading import load_task
from kinfeas.yielding import Yielding

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
    return arm.feasible & ~jumps(robot, joints, arm.joint_positions, DT)


@pytest.fixture
def yielding(solver):
    return Yielding(Following(solver, DT))


def test_commands_that_the_arm_can_follow_are_left_alone(solver, scene, yielding):
    wanted, _ = yielding(*scene)
    able = follows(solver, *scene)
    assert 0 < able.sum() < ROWS
    as_given, _ = Following(solver, DT)(*scene)
    np.testing.assert_array_equal(wanted[able], as_given[able])


def test_the_nearest_command_that_the_arm_can_follow_is_taken(solver, scene, yielding):
    action, base_pose, *rest = scene
    twist, arm = yielding(*scene)
    others, helped = yielding.others, 0
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


def test_the_arm_is_what_ik_finds_for_the_command_that_is_taken(solver, scene, yielding):
    _, base_pose, desired, joints = scene
    twist, arm = yielding(*scene)
    target = spatial.relative(desired, spatial.integrate(base_pose, twist, DT))
    alone = solver.solve(target, joints, solver.robot.max_joint_velocity * DT)
    np.testing.assert_array_equal(arm.feasible, alone.feasible)
    np.testing.assert_array_equal(arm.joint_positions, alone.joint_positions)


def test_no_row_depends_on_the_others(scene, yielding):
    together, _ = yielding(*scene)
    apart = [yielding(*(values[[i]] for values in scene))[0][0] for i in range(0, ROWS, 7)]
    np.testing.assert_array_equal(apart, together[::7])


def test_rows_that_stand_still_are_left_alone(solver, scene, yielding):
    held = np.arange(ROWS) % 2 == 0
    twist, arm = yielding(*scene, held)
    as_given, found = Following(solver, DT)(*scene)
    np.testing.assert_array_equal(twist[held], as_given[held])
    np.testing.assert_array_equal(arm.joint_positions[held], found.joint_positions[held])
    np.testing.assert_array_equal(twist[~held], yielding(*scene)[0][~held])


@pytest.mark.parametrize("policy", ["follow_ee_feedback", "pretrained"])
def test_an_arm_jumps_less_if_the_base_yields(policy):
    tiago, jumps_of = registry.load_robot("tiago"), []
    for yields in (False, True):
        world = World(tiago, load_task("ggr"), WorldConfig(yields=yields), seed=1)
        records = run_episodes(world, load_policy(policy, tiago), 24)
        jumps_of.append(records.jumps.mean())
    assert jumps_of[1] < 0.5 * jumps_of[0]


@pytest.mark.parametrize("asks", ["world", "pace"])
def test_a_world_yields_if_it_or_its_pace_says_so(asks):
    config, pace = WorldConfig(yields=asks == "world"), Pace(slow_down=2.0, yields=asks == "pace")
    world = World(registry.load_robot("tiago"), load_task("ggr"), config, 0, pace=pace)
    assert world.loop.pace == Pace(slow_down=2.0, yields=True)
