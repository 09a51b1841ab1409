from dataclasses import fields, replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from tests.kinematics.conftest import Pinocchio, draw

METRES, RADIANS = 1e-4, 1e-3
EXACT = IkOptions(pose_tolerance=False)
TIME = 0.1  # s of a control step


@pytest.fixture(scope="module")
def tiago():
    return IkSolver(load_robot("tiago"), EXACT)


@pytest.fixture(scope="module")
def hsr():
    return IkSolver(load_robot("hsr"))


def draw_free(solver, n, seed=0):
    joints = draw(solver.robot, 3 * n, seed)
    free = joints[~self_collides(solver.collision, joints)][:n]
    assert len(free) == n
    return free


def shuffled(joints):
    return np.random.default_rng(0).permutation(joints)


def displacement(robot, start, end):
    return np.abs(joint_displacement(robot, start, end))


def check_solutions(solver, joint_positions):
    lower, upper = solver.robot.joint_limits
    assert np.all((joint_positions >= lower) & (joint_positions <= upper))
    assert not np.any(self_collides(solver.collision, joint_positions))
    continuous = joint_positions[:, solver.robot.continuous]
    assert np.all((continuous > -np.pi) & (continuous <= np.pi))


def reported(solution):
    return np.stack([solution.position_error, solution.rotation_error], axis=1)


def test_round_trip(robot, judge):
    solver = IkSolver(robot, EXACT)
    joints = draw_free(solver, 2000)
    targets = forward(solver.chain, joints)
    solution = solver.solve(targets, shuffled(joints))
    solved = solution.feasible
    assert solved.mean() >= (0.995 if robot.name in ("pr2", "tiago", "hsr") else 0.98)
    check_solutions(solver, solution.joint_positions[solved])
    missed = judge.miss(targets[solved], solution.joint_positions[solved])
    assert np.all(missed.max(axis=0) <= [METRES, RADIANS])
    np.testing.assert_allclose(reported(solution)[solved], missed, rtol=0.0, atol=1e-9)


def test_the_bits_do_not_depend_on_the_batch(hsr):
    joints = draw_free(hsr, 600)
    targets, seeds = forward(hsr.chain, joints), shuffled(joints)
    targets[::3, :3] += np.random.default_rng(1).normal(scale=0.2, size=(200, 3))
    given = targets.copy(), seeds.copy()
    together = hsr.solve(targets, seeds)
    np.testing.assert_array_equal([*targets.T, *seeds.T], [*given[0].T, *given[1].T])
    assert 0 < together.feasible.sum() < 600
    again = IkSolver(hsr.robot).solve(targets, seeds)
    parts = [hsr.solve(targets[i : i + 7], seeds[i : i + 7]) for i in range(0, 600, 7)]
    order = np.random.default_rng(2).permutation(600)
    mixed = hsr.solve(targets[order], seeds[order])
    for name in (field.name for field in fields(together)):
        expected = getattr(together, name)
        np.testing.assert_array_equal(getattr(again, name), expected, err_msg=name)
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, expected, err_msg=name)
        np.testing.assert_array_equal(getattr(mixed, name), expected[order], err_msg=name)
    assert hsr.solve(np.empty((0, 7)), np.empty((0, 5))).feasible.shape == (0,)


def neighbours(solver, seed, displacements):
    """Return configurations, and targets of others that random displacements (n, v) away."""
    joints = draw_free(solver, 1000)
    low, high = solver.robot.joint_limits
    rng = np.random.default_rng(seed)
    moved = np.clip(joints + rng.uniform(-1.0, 1.0, joints.shape) * displacements, low, high)
    free = ~self_collides(solver.collision, moved)
    return joints[free], moved[free], forward(solver.chain, moved[free])


def test_solutions_from_the_seed_and_within_the_joint_step_come_first(tiago):
    robot, step = tiago.robot, TIME * tiago.robot.max_joint_velocity
    joints, _, targets = neighbours(tiago, 1, 0.02)
    warm = tiago.local().solve(targets, joints)
    solution = tiago.solve(targets, joints)
    assert solution.feasible.mean() >= 0.999
    assert warm.feasible.mean() >= 0.98
    solved = warm.feasible
    np.testing.assert_array_equal(solution.joint_positions[solved], warm.joint_positions[solved])
    assert np.median(displacement(robot, joints, solution.joint_positions).max(axis=1)) < 0.03
    joints, _, targets = neighbours(tiago, 2, 0.2 * step)
    anywhere, near = tiago.solve(targets, joints), tiago.solve(targets, joints, step)
    np.testing.assert_array_equal(anywhere.feasible, near.feasible)
    check_solutions(tiago, near.joint_positions[near.feasible])
    beyond = [
        np.any(displacement(robot, joints, each.joint_positions) > step * 1.001, axis=1).mean()
        for each in (near, anywhere)
    ]
    assert beyond[0] <= min(0.02, beyond[1])


def test_without_reconfiguration_solutions_are_within_the_joint_step(tiago):
    rng, robot = np.random.default_rng(4), tiago.robot
    joints, step = draw_free(tiago, 500), TIME * robot.max_joint_velocity
    far = rng.uniform(0.0, 3.0, (len(joints), 1)) * rng.uniform(-1.0, 1.0, joints.shape)
    targets = forward(tiago.chain, np.clip(joints + far * step, *robot.joint_limits))
    free = tiago.solve(targets, joints, step)
    bound = tiago.solve(targets, joints, step, allow_reconfiguration=False)
    solved = bound.feasible
    assert 0.1 < solved.mean() < free.feasible.mean()
    ends = bound.joint_positions[solved]
    assert np.all(displacement(robot, joints[solved], ends) <= step * (1.0 + 1e-9))
    np.testing.assert_array_equal(ends, free.joint_positions[solved])
    with pytest.raises(KinfeasError, match="max_joint_step"):
        tiago.solve(targets, joints, allow_reconfiguration=False)


def test_arms_go_to_their_guide_within_the_joint_step(tiago):
    rng, robot = np.random.default_rng(5), tiago.robot
    step, turns = TIME * robot.max_joint_velocity, 2.0 * np.pi * robot.continuous
    seed, guide, targets = neighbours(tiago, 5, 0.5 * step)
    alone = tiago.solve(targets, seed, step)
    guided = tiago.solve(targets, seed, step, posture_guide=guide + turns)
    reached = displacement(robot, guided.joint_positions, guide).max(axis=1) < 1e-6
    assert reached.mean() > 0.99
    assert displacement(robot, alone.joint_positions, guide).max(axis=1).mean() > 0.01
    beyond = rng.permutation(guide)  # far away, so that only a part of the displacement is possible
    bound = tiago.solve(targets, seed, step, posture_guide=beyond, allow_reconfiguration=False)
    check_solutions(tiago, bound.joint_positions[bound.feasible])
    assert bound.feasible.mean() > 0.99
    moved = displacement(robot, seed, bound.joint_positions)
    assert np.all(moved <= step * (1.0 + 1e-9))
    none = tiago.solve(targets, seed, step, posture_guide=np.full_like(seed, np.nan))
    np.testing.assert_array_equal(none.joint_positions, alone.joint_positions)


def test_arms_that_cannot_reach_a_target_in_a_step_jump_to_their_guide(tiago):
    rng, robot = np.random.default_rng(6), tiago.robot
    step, joints = TIME * robot.max_joint_velocity, draw_free(tiago, 500)
    far = 1.3 * rng.uniform(-1.0, 1.0, joints.shape) * step
    guide = np.clip(joints + far, *robot.joint_limits)
    targets = forward(tiago.chain, guide)
    bound = tiago.solve(targets, joints, step, posture_guide=guide, allow_reconfiguration=False)
    jumps = ~bound.feasible & tiago.admissible(guide)
    assert jumps.mean() > 0.1
    near = []
    for posture_guide in (guide, None):
        arm = tiago.solve(targets, joints, step, posture_guide=posture_guide)
        away = displacement(robot, arm.joint_positions, guide).max(axis=1)
        near.append((away[jumps] < 1e-9).mean())
    assert near[0] > 0.8  # the EE of others is too far from the target
    assert near[1] < 0.05


def test_redundant_joints_are_centred(tiago):
    """While the EE trembles by a millimetre."""
    robot, start, rng = tiago.robot, draw_free(tiago, 100), np.random.default_rng(3)
    bounded = np.isfinite(np.subtract(*robot.joint_limits))
    lower, upper = (limit[bounded] for limit in robot.joint_limits)
    home, ends = forward(tiago.chain, start), [start]
    for share in (1.0, 0.0):
        solver, joints = IkSolver(robot, replace(EXACT, centering=share)), start
        for _ in range(40):
            shift = rng.uniform(-1e-3, 1e-3, (len(start), 3))
            targets = home + np.pad(shift, ((0, 0), (0, 4)))
            solution = solver.solve(targets, joints, TIME * robot.max_joint_velocity)
            assert solution.feasible.mean() > 0.9
            joints = solution.joint_positions
        ends.append(joints)
    away = [
        np.abs(2.0 * (each[:, bounded] - lower) / (upper - lower) - 1.0).mean() for each in ends
    ]
    assert away[1] < away[0] - 0.05
    assert abs(away[2] - away[0]) < 0.02


def test_an_ee_at_rest_leaves_the_arm_at_rest_and_seeds_may_be_beyond_the_limits(tiago):
    joints = draw_free(tiago, 200)
    targets = forward(tiago.chain, joints)
    solution = tiago.solve(targets, joints, TIME * tiago.robot.max_joint_velocity)
    np.testing.assert_array_equal(solution.joint_positions, joints)
    beyond = tiago.solve(targets, shuffled(joints) * 3.0 + 5.0)
    assert beyond.feasible.mean() >= 0.99
    check_solutions(tiago, beyond.joint_positions[beyond.feasible])


def test_arms_beyond_a_limit_stay_within_the_step_and_come_back(robot):
    """A joint may be measured up to 0.05 beyond a limit; it must neither jump back nor go on."""
    solver, rng = IkSolver(robot), np.random.default_rng(7)
    lower, upper = robot.joint_limits
    step, inner = 0.02 * robot.max_joint_velocity, draw_free(solver, 400)
    row = np.arange(len(inner))
    joint = rng.choice(np.flatnonzero(np.isfinite(upper - lower)), len(inner))
    above, excess = rng.random(len(inner)) < 0.5, rng.uniform(0.0, 0.05, len(inner))
    seeds = inner.copy()
    seeds[row, joint] = np.where(above, upper[joint] + excess, lower[joint] - excess)
    seeds = seeds[~self_collides(solver.collision, seeds)]
    low, high = np.minimum(lower, seeds), np.maximum(upper, seeds)
    ends = np.clip(seeds + rng.uniform(-0.5, 0.5, seeds.shape) * step, low, high)
    targets = forward(solver.chain, ends)
    for allowed in (False, True):
        solution = solver.solve(targets, seeds, step, allow_reconfiguration=allowed)
        assert solution.feasible.mean() > 0.97
        joints = solution.joint_positions
        assert np.all((joints >= low) & (joints <= high))
        near = (displacement(robot, seeds, joints) <= step * (1.0 + 1e-9)).all(axis=1)
        assert near.all() if not allowed else near.mean() > 0.97
        # What is no nearby solution is within the limits.
        assert np.all((joints >= lower) & (joints <= upper) | near[:, np.newaxis])
    assert solver.solve(forward(solver.chain, seeds), seeds, step).feasible.all()


def test_targets_out_of_reach_or_not_finite_keep_the_seed(tiago):
    joints = draw_free(tiago, 50)
    targets = forward(tiago.chain, joints)
    targets[:48, :3] *= 3.0 / np.linalg.norm(targets[:48, :3], axis=1, keepdims=True)
    targets[0, 0], targets[1, 2] = np.nan, -np.inf
    solution = tiago.solve(targets, joints)
    np.testing.assert_array_equal(solution.feasible, np.arange(50) >= 48)
    np.testing.assert_array_equal(solution.joint_positions[:48], joints[:48])
    metres, radians = solution.position_error[2:48], solution.rotation_error[2:48]
    assert np.all((metres > 0.3) & (metres < 6.0))
    assert np.all((radians >= 0.0) & (radians <= np.pi + 1e-9))


@pytest.mark.parametrize(("targets", "seeds", "step", "name"), [
    ((1, 7), (3, 5), 5, "seeds"), ((2, 6), (2, 5), 5, "targets"), ((2, 7), (2, 5), 0, "max_joint"),
])  # fmt: skip
def test_other_shapes_are_errors(hsr, targets, seeds, step, name):
    with pytest.raises(KinfeasError, match=f"^{name}"):
        hsr.solve(np.ones(targets), np.ones(seeds), np.ones(step))


def perturbed(solver, joints, scale):
    rng, targets = np.random.default_rng(1), forward(solver.chain, joints)
    targets += rng.normal(scale=scale, size=targets.shape)
    targets[:, 3:] /= np.linalg.norm(targets[:, 3:], axis=1, keepdims=True)
    return targets


def test_feasible_is_within_the_pose_tolerance(hsr):
    solver = IkSolver(hsr.robot, IkOptions(self_collision=False))
    joints, tolerance = draw(hsr.robot, 1000), hsr.robot.pose_tolerance
    targets = perturbed(solver, joints, 0.08)
    solution = solver.solve(targets, joints)
    within = np.all(reported(solution) <= [tolerance.position, tolerance.rotation], axis=1)
    np.testing.assert_array_equal(solution.feasible, within)
    assert 100 < within.sum() < 1000
    missed = Pinocchio(hsr.robot).miss(targets[within], solution.joint_positions[within])
    np.testing.assert_allclose(reported(solution)[within], missed, rtol=0.0, atol=1e-9)
    assert missed[:, 0].max() > 0.05  # the tolerance is used


def test_a_seed_within_the_pose_tolerance_always_has_a_solution(hsr):
    solver, tolerance = IkSolver(hsr.robot, IkOptions(restarts=0)), hsr.robot.pose_tolerance
    joints = draw(hsr.robot, 20_000)
    joints = joints[~self_collides(solver.collision, joints)]
    targets = perturbed(solver, joints, 0.05)
    metres, radians = distance(forward(solver.chain, joints), targets)
    stay = (metres <= tolerance.position) & (radians <= tolerance.rotation)
    assert stay.sum() > 5000
    for step in (None, TIME * hsr.robot.max_joint_velocity):
        assert solver.solve(targets[stay], joints[stay], step).feasible.all()


def test_solutions_keep_margins_from_joint_limits_and_shapes(tiago):
    margins = replace(EXACT, joint_margin=0.1, self_clearance=0.02)
    careful, robot = IkSolver(tiago.robot, margins), tiago.robot
    targets = forward(tiago.chain, draw_free(tiago, 60, seed=2))
    solution = careful.solve(targets, draw_free(tiago, 60, seed=3))
    assert solution.feasible.sum() >= 40
    joints = solution.joint_positions[solution.feasible]
    lower, upper = robot.joint_limits
    assert (np.minimum(joints - lower, upper - joints) >= 0.05 * (upper - lower) - 1e-9).all()
    assert not self_collides(careful.collision, joints).any()
    near = tiago.solve(targets, draw_free(tiago, 60, seed=3)).joint_positions
    assert self_collides(careful.collision, near).any()
