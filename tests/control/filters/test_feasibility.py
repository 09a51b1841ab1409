from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.motion_sequence import Plan
from kinfeas.control.period import KinematicStep, Period
from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.evaluation.evaluate import evaluate, prepare
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides, in_base
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import exceeds_joint_velocity
from tests.kinematics.conftest import draw_solids

DT, ROWS = 0.5, 64


@pytest.fixture(scope="module")
def solver():
    """IK of TIAGo, whose slow torso often exceeds its velocity."""
    return IkSolver(load_robot("tiago"))


@pytest.fixture(params=[0, 6], ids=["empty floor", "solids"])
def loop(solver, request):
    """Arms anywhere, EEs that are to rest, and the parts of a loop that the filter reads."""
    robot, rng = solver.robot, np.random.default_rng(0)
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (ROWS, len(robot.arm)))
    base_pose = spatial.planar_pose(*rng.uniform(-3.0, 3.0, (3, ROWS)))
    desired = spatial.compose(base_pose, forward(solver.chain, joints))
    return SimpleNamespace(
        robot=robot,
        dt=DT,
        command_size=command_size(robot.base),
        kinematic_step=KinematicStep(solver, DT),
        period=Period(
            base_pose=base_pose,
            joints=joints,
            desired=desired,
            solids=draw_solids(ROWS, request.param, reach=4.0) if request.param else None,
            plan=Plan(desired, desired, [], np.full(ROWS, DT)),
            time_scale=np.ones(ROWS),
        ),
    )


@pytest.fixture
def command(loop):
    return np.random.default_rng(1).uniform(-1.0, 1.0, (ROWS, loop.command_size))


def filtered(loop, command):
    one = FeasibilityFilter()
    one.reset(loop, np.arange(ROWS))
    return one(command, None), one.candidates


def feasible(loop, command, rows):
    """Return whether IK without restarts finds an arm in time, and the base is free, shape (m,)."""
    solver = loop.kinematic_step.solver
    local = IkSolver(solver.robot, replace(solver.options, restarts=0))
    given = loop.period.of(rows)
    base, joints = given.base_pose, given.joints
    twist = base_twist(solver.robot.base, base, command, DT)
    reached = spatial.integrate(base, twist, DT)
    target = spatial.relative(given.desired, reached)
    solids = given.solids or Solids.empty(len(rows))
    limit = solver.robot.max_joint_velocity * DT
    arm = local.solve(target, joints, limit, solids=in_base(solids, reached))
    jumps = exceeds_joint_velocity(solver.robot, joints, arm.joint_positions, DT)
    touches = collides(solver.collision, arm.joint_positions, reached, solids)
    assert not np.any(touches[:, 1] & arm.feasible)
    return arm.feasible & ~jumps & ~touches[:, 0]


def test_feasible_commands_stay_and_others_become_the_nearest_candidate(loop, command):
    found, candidates = filtered(loop, command)
    able = feasible(loop, command, np.arange(ROWS))
    assert 0 < able.sum() < ROWS
    np.testing.assert_array_equal(found[able], command[able])
    helped = 0
    for row in np.flatnonzero(~able):
        fits = candidates[feasible(loop, candidates, np.repeat(row, len(candidates)))]
        away = np.linalg.norm(fits - command[row], axis=1)
        expected = fits[away.argmin()] if len(fits) else command[row]
        np.testing.assert_array_equal(found[row], expected)
        helped += len(fits) > 0
    assert helped > 0


def test_paused_rows_stay_and_change_no_other(loop, command):
    together, _ = filtered(loop, command)
    loop.period.paused = np.arange(ROWS) % 2 == 0
    found, _ = filtered(loop, command)
    np.testing.assert_array_equal(found[loop.period.paused], command[loop.period.paused])
    np.testing.assert_array_equal(found[~loop.period.paused], together[~loop.period.paused])


def mean_deviation_of_hsr(most):
    chosen = f"world.filters=[{{name: feasibility, max_deviation: {most}}}]"
    config, policy = prepare("pretrained", "hsr", "ggr", episodes=16, overrides=[chosen])
    return evaluate(config, policy, "pretrained")["mean_deviation_m"]


@pytest.mark.slow
def test_max_deviation_keeps_the_arm_of_hsr_near_its_pose():
    assert mean_deviation_of_hsr(0.02) < 0.95 * mean_deviation_of_hsr(1.0)
