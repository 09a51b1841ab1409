from dataclasses import replace

import numpy as np
import pytest

from kinfeas import registry, spatial
from kinfeas.drive import action_size, base_twist
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.evaluation.policies import load_policy
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


def test_commands_that_the_arm_can_follow_are_left_alone(solver, scene):
    action, *rest = scene
    taken = Yielding(solver, DT).aside(*scene)
    able = follows(solver, *scene)
    assert 0 < able.sum() < ROWS
    np.testing.assert_array_equal(taken[able], action[able])
    assert np.all(np.abs(taken) <= 1.0)
    # What is taken in place of the others can be followed; where nothing can, they stay.
    changed = np.any(taken != action, axis=1)
    assert changed.any()
    assert follows(solver, taken, *rest)[changed].all()


def test_the_nearest_command_that_the_arm_can_follow_is_taken(solver, scene):
    action, *rest = scene
    yielding = Yielding(solver, DT)
    taken = yielding.aside(*scene)
    others = yielding.others
    for row in np.flatnonzero(~follows(solver, *scene)):
        alone = [np.repeat(values[[row]], len(others), axis=0) for values in rest]
        able = others[follows(solver, others, *alone)]
        nearest = np.linalg.norm(able - action[row], axis=1).min() if len(able) else 0.0
        assert np.linalg.norm(taken[row] - action[row]) == pytest.approx(nearest)


def test_no_row_depends_on_the_others(solver, scene):
    yielding = Yielding(solver, DT)
    together = yielding.aside(*scene)
    apart = [yielding.aside(*(values[[i]] for values in scene))[0] for i in range(0, ROWS, 7)]
    np.testing.assert_array_equal(apart, together[::7])


def test_rows_that_stand_still_are_left_alone(solver, scene):
    held = np.arange(ROWS) % 2 == 0
    taken = Yielding(solver, DT).aside(*scene, held)
    np.testing.assert_array_equal(taken[held], scene[0][held])
    np.testing.assert_array_equal(taken[~held], Yielding(solver, DT).aside(*scene)[~held])


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
