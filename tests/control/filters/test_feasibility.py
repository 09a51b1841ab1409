from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.drive import base_twist, command_size
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.period import MotionStep, Period
from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.evaluation.evaluate import evaluate, prepare
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
def period(solver, request):
    """Arms anywhere and EEs that are to rest, with random commands."""
    robot, rng = solver.robot, np.random.default_rng(0)
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (ROWS, len(robot.arm)))
    base_pose = spatial.planar_pose(*rng.uniform(-3.0, 3.0, (3, ROWS)))
    desired = spatial.compose(base_pose, forward(solver.chain, joints))
    size = ROWS, command_size(robot.base)
    return Period(
        command=np.random.default_rng(1).uniform(-1.0, 1.0, size),
        base_pose=base_pose,
        joints=joints,
        desired=desired,
        solids=draw_solids(ROWS, request.param, reach=4.0) if request.param else None,
        step=MotionStep(desired, desired, [], np.full(ROWS, DT)),
        time_scale=np.ones(ROWS),
        motions=None,
    )


def feasible(solver, period, command, rows):
    """Return whether IK without restarts finds an arm in time, and the base is free, shape (m,)."""
    local = IkSolver(solver.robot, replace(solver.options, restarts=0))
    given = period.of(rows)
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


def test_feasible_commands_stay_and_others_become_the_nearest_candidate(solver, period):
    command_filter, command = FeasibilityFilter(solver, DT), period.command
    found, candidates = command_filter(period).command, command_filter.candidates
    able = feasible(solver, period, command, np.arange(ROWS))
    assert 0 < able.sum() < ROWS
    np.testing.assert_array_equal(found[able], command[able])
    helped = 0
    for row in np.flatnonzero(~able):
        fits = candidates[feasible(solver, period, candidates, np.repeat(row, len(candidates)))]
        away = np.linalg.norm(fits - command[row], axis=1)
        expected = fits[away.argmin()] if len(fits) else command[row]
        np.testing.assert_array_equal(found[row], expected)
        helped += len(fits) > 0
    assert helped > 0


def test_paused_rows_stay_and_change_no_other(solver, period):
    command_filter, paused = FeasibilityFilter(solver, DT), np.arange(ROWS) % 2 == 0
    together = command_filter(period).command
    found = command_filter(replace(period, paused=paused)).command
    np.testing.assert_array_equal(found[paused], period.command[paused])
    np.testing.assert_array_equal(found[~paused], together[~paused])


def mean_deviation_of_hsr(most):
    chosen = f"world.filters=[{{name: feasibility, max_deviation: {most}}}]"
    config, policy = prepare("pretrained", "hsr", "ggr", episodes=16, overrides=[chosen])
    return evaluate(config, policy, "pretrained")["mean_deviation_m"]


@pytest.mark.slow
def test_max_deviation_keeps_the_arm_of_hsr_near_its_pose():
    assert mean_deviation_of_hsr(0.02) < 0.95 * mean_deviation_of_hsr(1.0)
