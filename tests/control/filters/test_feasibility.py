from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.filters.time_scaling import TimeScalingFilter
from kinfeas.control.period import Period
from kinfeas.control.subgoal_motions import MotionStep
from kinfeas.core import spatial
from kinfeas.core.response import ResponseModel
from kinfeas.core.solids import Solids
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import collides, in_base
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import exceeds_joint_velocity

DT, ROWS, AT_ONCE = 0.5, 64, ResponseModel()


@pytest.fixture(scope="module")
def solver():
    """IK of TIAGo, whose slow torso often exceeds its velocity."""
    return IkSolver(load_robot("tiago"))


def boxes(base_pose, places):
    """Return boxes of random height on the floor, so near that some bases drive into them."""
    rng, solids = np.random.default_rng(0), Solids.empty(ROWS, places)
    angle, distance = rng.uniform([[-np.pi], [0.4]], [[np.pi], [0.6]], (ROWS, 2, places)).swapaxes(
        0, 1
    )
    offset = distance[..., np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    solids.pose[..., :2] = base_pose[:, np.newaxis, :2] + offset
    solids.size[..., :2], solids.size[..., 3] = 0.1, rng.uniform(0.1, 1.0, (ROWS, places))
    return solids


@pytest.fixture(params=[0, 3], ids=["empty floor", "solids"])
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
        solids=boxes(base_pose, request.param) if request.param else None,
        step=MotionStep(desired, desired, [], np.full(ROWS, DT)),
        time_scale=np.ones(ROWS),
        motions=None,
    )


def feasible(solver, period, command, rows):
    """Return whether IK without restarts finds an arm in time, and the base is free, shape (m,)."""
    local = solver.local()
    inputs, limit = period.of(rows), solver.robot.max_joint_velocity * DT
    twist = base_twist(solver.robot.base, inputs.base_pose, command, DT)
    reached = spatial.integrate(inputs.base_pose, twist, DT)
    target = spatial.relative(inputs.desired, reached)
    solids = inputs.solids or Solids.empty(len(rows))
    arm = local.solve(target, inputs.joints, limit, solids=in_base(solids, reached))
    jumps = exceeds_joint_velocity(solver.robot, inputs.joints, arm.joint_positions, DT)
    touches = collides(solver.collision, arm.joint_positions, reached, solids)
    assert not np.any(touches[:, 1] & arm.feasible)
    return arm.feasible & ~jumps & ~touches[:, 0]


def test_feasible_commands_stay_and_others_become_the_nearest_candidate(solver, period):
    command_filter = FeasibilityFilter(solver, DT, response=AT_ONCE)
    command = period.command
    filtered, candidates = command_filter(period).command, command_filter.candidates
    able = feasible(solver, period, command, np.arange(ROWS))
    assert 0 < able.sum() < ROWS
    np.testing.assert_array_equal(filtered[able], command[able])
    helped = 0
    for row in np.flatnonzero(~able):
        good = candidates[feasible(solver, period, candidates, np.repeat(row, len(candidates)))]
        distance = np.linalg.norm(good - command[row], axis=1)
        expected = good[distance.argmin()] if len(good) else command[row]
        np.testing.assert_array_equal(filtered[row], expected)
        helped += len(good) > 0
    assert helped > 0


def test_paused_rows_stay_and_change_no_other(solver, period):
    command_filter = FeasibilityFilter(solver, DT, response=AT_ONCE)
    paused = np.arange(ROWS) % 2 == 0
    alone = command_filter(period).command
    filtered = command_filter(replace(period, paused=paused)).command
    np.testing.assert_array_equal(filtered, np.where(paused[:, np.newaxis], period.command, alone))


class Straight:
    """EE motions of constant twists."""

    def __init__(self, begin):
        self.begin = begin
        self.twist = np.random.default_rng(2).uniform(-1.0, 1.0, (len(begin), 6))

    def step(self, time_scale):
        desired = spatial.integrate(self.begin, self.twist, DT * time_scale)
        return MotionStep(desired, desired, [], DT * time_scale)

    def arm_target(self, step, paused):
        return step.desired


def test_time_scaling_slows_the_planned_motion_and_holds_where_nothing_is_feasible(solver, period):
    planned = np.random.default_rng(3).uniform(0.2, 1.0, ROWS)
    begun = replace(period, motions=Straight(period.desired)).slowed(planned)
    scaled = TimeScalingFilter(solver, DT, response=AT_ONCE)(begun)
    fraction = scaled.time_scale / planned
    assert {0.0, 0.5, 1.0} <= set(fraction.tolist()) <= {0.0, 0.25, 0.5, 1.0}
    able = feasible(solver, scaled, scaled.command, np.arange(ROWS))
    assert not (scaled.time_scale[~able].any() or scaled.command[~able].any())
    assert (fraction[able] < 1.0).any()
    # Where the EE rests, the base does not depend on the policy.
    other = TimeScalingFilter(solver, DT, response=AT_ONCE)(replace(begun, command=-begun.command))
    rest = (scaled.time_scale == 0.0) & (other.time_scale == 0.0)
    np.testing.assert_array_equal(scaled.command[rest], other.command[rest])


@pytest.mark.parametrize(("metres", "fraction"), [(0.005, 1.0), (0.02, 0.5), (0.04, 0.0)])
def test_arms_with_a_pose_tolerance_wait_only_where_they_deviate_far(hsr, metres, fraction):
    solver, dt = IkSolver(hsr), 0.002
    joints, base_pose = hsr.home["home"][np.newaxis], spatial.IDENTITY[np.newaxis]
    desired = forward(solver.chain, joints)
    desired[:, 0] += metres  # farther than base and arm move in a period
    resting = Straight(desired)
    resting.twist[:] = 0.0
    begun = Period(
        command=np.zeros((1, 3)), base_pose=base_pose, joints=joints, desired=desired,
        step=MotionStep(desired, desired, [], np.full(1, dt)), time_scale=np.ones(1),
        motions=resting,
    )  # fmt: skip
    scaled = TimeScalingFilter(solver, dt, response=AT_ONCE, max_deviation=0.01)(begun)
    assert scaled.time_scale == fraction
