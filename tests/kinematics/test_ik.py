import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, wrap
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.search import _out_of_reach
from kinfeas.kinematics.self_collision import self_collides

METRES, RADIANS = 1e-4, 1e-3


def draw_free(solver, draw, n, seed=0):
    """Return n random configurations, free of self-collision."""
    joints = draw(solver.robot, 3 * n, seed)
    free = joints[~self_collides(solver.collision, joints)][:n]
    assert len(free) == n
    return free


def shuffled(joints, seed=0):
    return np.random.default_rng(seed).permutation(joints)


def max_joint_step(robot, start, end):
    """Return how far joints move, the short way about, shape (n, v)."""
    return np.abs(np.where(robot.continuous, wrap(end - start), end - start))


def check_solutions(solver, joint_positions):
    robot = solver.robot
    lower, upper = robot.joint_limits
    assert np.all(joint_positions >= lower)
    assert np.all(joint_positions <= upper)
    assert not np.any(self_collides(solver.collision, joint_positions))
    endless = joint_positions[:, robot.continuous]
    assert np.all((endless > -np.pi) & (endless <= np.pi))


def assert_same(one, other):
    for name in ("joint_positions", "feasible", "position_error", "rotation_error"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_round_trip(exact_solver, judge, draw, record_property):
    """FK, IK from somewhere else, FK: 10,000 times."""
    joints = draw_free(exact_solver, draw, 10_000)
    targets = forward(exact_solver.chain, joints)
    solution = exact_solver.solve(targets, shuffled(joints))
    solved = solution.feasible
    record_property("solved", float(solved.mean()))
    assert solved.mean() >= 0.995
    check_solutions(exact_solver, solution.joint_positions[solved])
    missed = judge.miss(targets[solved], solution.joint_positions[solved])
    assert missed[:, 0].max() <= METRES
    assert missed[:, 1].max() <= RADIANS
    reported = np.stack([solution.position_error, solution.rotation_error], axis=1)[solved]
    np.testing.assert_allclose(reported, missed, rtol=0.0, atol=1e-9)


def test_round_trip_of_followers(odd_robot, odd_judge, draw):
    solver = IkSolver(odd_robot)
    joints = draw_free(solver, draw, 1000)
    targets = forward(solver.chain, joints)
    solution = solver.solve(targets, shuffled(joints))
    solved = solution.feasible
    assert solved.mean() >= 0.98
    check_solutions(solver, solution.joint_positions[solved])
    missed = odd_judge.miss(targets[solved], solution.joint_positions[solved])
    assert missed[:, 0].max() <= METRES
    assert missed[:, 1].max() <= RADIANS


def test_same_bits_however_the_batch_is_split(solver, draw):
    joints = draw_free(solver, draw, 600)
    targets, seeds = forward(solver.chain, joints), shuffled(joints)
    targets[::3, :3] += np.random.default_rng(1).normal(scale=0.2, size=(200, 3))
    together = solver.solve(targets, seeds)
    assert 0 < together.feasible.sum() < 600
    assert_same(together, solver.solve(targets, seeds))
    assert_same(together, IkSolver(solver.robot).solve(targets, seeds))
    parts = [solver.solve(targets[i : i + 7], seeds[i : i + 7]) for i in range(0, 600, 7)]
    for name in ("joint_positions", "feasible", "position_error", "rotation_error"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(together, name), err_msg=name)
    order = np.random.default_rng(2).permutation(600)
    mixed = solver.solve(targets[order], seeds[order])
    np.testing.assert_array_equal(mixed.joint_positions, together.joint_positions[order])


def test_arguments_are_not_written_to(solver, draw):
    joints = draw_free(solver, draw, 20)
    targets, seeds = forward(solver.chain, joints), shuffled(joints)
    before = targets.copy(), seeds.copy()
    solver.solve(targets, seeds)
    np.testing.assert_array_equal(targets, before[0])
    np.testing.assert_array_equal(seeds, before[1])


def test_a_solution_from_the_seed_comes_first(robot, exact_solver, draw):
    """Small EE motions: where a descent from the seed alone solves them, it is the answer."""
    rng = np.random.default_rng(1)
    joints = draw_free(exact_solver, draw, 2000)
    lower, upper = robot.joint_limits
    moved = np.clip(joints + rng.normal(scale=0.01, size=joints.shape), lower, upper)
    free = ~self_collides(exact_solver.collision, moved)
    joints, targets = joints[free], forward(exact_solver.chain, moved[free])
    warm = IkSolver(robot, IkOptions(pose_tolerance=False, restarts=0)).solve(targets, joints)
    found = exact_solver.solve(targets, joints)
    assert found.feasible.mean() >= 0.999
    assert warm.feasible.mean() >= 0.98
    solved = warm.feasible
    np.testing.assert_array_equal(found.joint_positions[solved], warm.joint_positions[solved])
    travelled = max_joint_step(robot, joints, found.joint_positions).max(axis=1)
    assert np.median(travelled) < 0.03
    assert np.quantile(travelled, 0.95) < 0.2


def test_a_solution_in_time_comes_before_any_other(robot, exact_solver, draw):
    """Where joints that move as far as they may reach the target, none is asked to move farther."""
    rng = np.random.default_rng(2)
    joints = draw_free(exact_solver, draw, 1000)
    lower, upper = robot.joint_limits
    reach = 0.1 * robot.max_joint_velocity
    moved = np.clip(joints + rng.uniform(-0.2, 0.2, joints.shape) * reach, lower, upper)
    free = ~self_collides(exact_solver.collision, moved)
    joints, targets = joints[free], forward(exact_solver.chain, moved[free])
    patient = exact_solver.solve(targets, joints)
    hasty = exact_solver.solve(targets, joints, reach)
    np.testing.assert_array_equal(patient.feasible, hasty.feasible)
    check_solutions(exact_solver, hasty.joint_positions[hasty.feasible])

    def late(solution):
        return np.any(
            max_joint_step(robot, joints, solution.joint_positions) > reach * 1.001, axis=1
        )

    assert late(hasty).mean() <= 0.02
    assert late(hasty).mean() <= late(patient).mean()


def test_without_swings_all_solutions_are_in_time(robot, exact_solver, draw):
    rng = np.random.default_rng(4)
    joints = draw_free(exact_solver, draw, 500)
    reach = 0.1 * robot.max_joint_velocity
    far = rng.uniform(0.0, 3.0, (len(joints), 1)) * rng.uniform(-1.0, 1.0, joints.shape)
    targets = forward(exact_solver.chain, np.clip(joints + far * reach, *robot.joint_limits))
    patient = exact_solver.solve(targets, joints, reach)
    hasty = exact_solver.solve(targets, joints, reach, allow_reconfiguration=False)
    assert 0.1 < hasty.feasible.mean() < patient.feasible.mean()
    # They are the ones that come before any other.
    found, same = hasty.joint_positions[hasty.feasible], patient.joint_positions[hasty.feasible]
    assert np.all(max_joint_step(robot, joints[hasty.feasible], found) <= reach * (1.0 + 1e-9))
    np.testing.assert_array_equal(found, same)


def test_without_reconfiguration_the_joint_step_must_be_known(solver):
    with pytest.raises(KinfeasError, match="without reconfiguration, max_joint_step must be given"):
        solver.solve(
            np.ones((1, 7)), np.zeros((1, len(solver.robot.arm))), allow_reconfiguration=False
        )


def tremble(solver, joints, steps):
    """Return where the arms end whose EEs tremble by a millimetre about where they are."""
    home, rng = forward(solver.chain, joints), np.random.default_rng(3)
    reach = 0.1 * solver.robot.max_joint_velocity
    for _ in range(steps):
        targets = home.copy()
        targets[:, :3] += rng.uniform(-1e-3, 1e-3, (len(joints), 3))
        solution = solver.solve(targets, joints, reach)
        assert solution.feasible.all()
        check_solutions(solver, solution.joint_positions)
        joints = solution.joint_positions
    return joints


def well_conditioned(judge, joints):
    """Return which arms are far from singular, so that their EEs can go anywhere in time."""
    strength = [np.linalg.svd(judge.jacobian(q), compute_uv=False) for q in joints]
    return np.array([values[min(6, joints.shape[1]) - 1] > 0.05 for values in strength])


def test_spare_freedom_goes_to_the_middle_of_the_joint_ranges(robot, judge, draw):
    """Of arms with more joints than a pose has dimensions; others have nothing to give."""
    drawn, free = (IkSolver(robot, IkOptions(centering=centering)) for centering in (1.0, 0.0))
    inner = draw(robot, 400)
    bounded = np.isfinite(np.subtract(*robot.joint_limits))
    lower, upper = (limit[bounded] for limit in robot.joint_limits)
    room = np.minimum(inner[:, bounded] - lower, upper - inner[:, bounded]) > 0.05 * (upper - lower)
    inner = inner[room.all(axis=1) & ~self_collides(drawn.collision, inner)][:60]
    start = inner[well_conditioned(judge, inner)]
    assert len(start) > 20
    ends = [tremble(solver, start, steps=40) for solver in (drawn, free)]
    if len(robot.arm) <= 6:
        np.testing.assert_array_equal(*ends)
        return

    def away(joints):
        return np.abs(2.0 * (joints[:, bounded] - lower) / (upper - lower) - 1.0).mean(axis=1)

    assert away(ends[0]).mean() < away(start).mean() - 0.05
    assert abs(away(ends[1]).mean() - away(start).mean()) < 0.02


def test_drawing_misses_no_solution_in_time(robot, draw):
    drawn, free = (IkSolver(robot, IkOptions(centering=centering)) for centering in (1.0, 0.0))
    reach = 0.1 * robot.max_joint_velocity
    joints = draw_free(drawn, draw, 2000)
    targets = forward(drawn.chain, joints)
    targets[:, :3] += np.random.default_rng(4).normal(scale=0.01, size=(2000, 3))
    found, others = (solver.solve(targets, joints, reach) for solver in (drawn, free))
    in_time = [
        one.feasible
        & np.all(max_joint_step(robot, joints, one.joint_positions) <= reach * 1.001, axis=1)
        for one in (found, others)
    ]
    assert in_time[1].mean() > 0.3
    assert np.all(in_time[0][in_time[1]])
    np.testing.assert_array_equal(found.feasible, others.feasible)


def test_an_ee_at_rest_leaves_the_arm_at_rest(solver, draw):
    joints = draw_free(solver, draw, 200)
    targets = forward(solver.chain, joints)
    solution = solver.solve(targets, joints, 0.1 * solver.robot.max_joint_velocity)
    np.testing.assert_array_equal(solution.joint_positions, joints)


def test_the_seed_itself_is_an_answer(robot, exact_solver, draw):
    joints = draw_free(exact_solver, draw, 500)
    solution = exact_solver.solve(forward(exact_solver.chain, joints), joints)
    assert solution.feasible.all()
    np.testing.assert_allclose(
        max_joint_step(robot, joints, solution.joint_positions), 0.0, atol=1e-12
    )


def test_of_several_solutions_a_near_one_is_taken(robot, exact_solver, draw):
    """More candidates bring the answer nearer, by the time that the slowest joint needs."""
    joints = draw_free(exact_solver, draw, 500)
    targets, seeds = forward(exact_solver.chain, joints), shuffled(joints)
    seconds = []
    for candidates in (1, 3):
        solver = IkSolver(robot, IkOptions(pose_tolerance=False, candidates=candidates))
        solution = solver.solve(targets, seeds)
        travelled = max_joint_step(robot, seeds, solution.joint_positions)
        needed = (travelled / robot.max_joint_velocity).max(axis=1)
        seconds.append(needed[solution.feasible])
    assert len(seconds[0]) == len(seconds[1])
    assert np.all(seconds[1] <= seconds[0])
    assert seconds[1].mean() < seconds[0].mean()


def test_out_of_reach_keeps_the_seed(robot, solver, draw):
    joints = draw_free(solver, draw, 50)
    targets = forward(solver.chain, joints)
    targets[:, :3] *= 3.0 / np.linalg.norm(targets[:, :3], axis=1, keepdims=True)
    solution = solver.solve(targets, joints)
    assert not solution.feasible.any()
    np.testing.assert_array_equal(solution.joint_positions, joints)
    # An attempt was made, and no arm is so long as to come near.
    assert np.all((solution.position_error > 0.3) & (solution.position_error < 6.0))
    assert np.all((solution.rotation_error >= 0.0) & (solution.rotation_error <= np.pi + 1e-9))


def test_just_out_of_reach_reports_what_is_missing(solver, draw):
    """Poses 2 to 20 cm off reachable ones: no solution, and a residual of about that."""
    joints = draw_free(solver, draw, 300)
    targets = forward(solver.chain, joints)
    shift = np.random.default_rng(1).normal(size=(300, 3))
    targets[:, :3] += 0.2 * shift / np.linalg.norm(shift, axis=1, keepdims=True)
    solution = solver.solve(targets, joints)
    failed = ~solution.feasible
    assert np.isfinite(solution.position_error).all()
    assert np.isfinite(solution.rotation_error).all()
    assert np.all(solution.position_error[failed] <= 0.5)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_answer_to_numbers_that_are_not_finite(robot, draw, bad):
    solver = IkSolver(robot, IkOptions(self_collision=False))
    joints = draw(robot, 4)
    targets = forward(solver.chain, joints)
    targets[0, 0], targets[1, 2] = bad, -bad
    solution = solver.solve(targets, joints)
    np.testing.assert_array_equal(solution.feasible, [False, False, True, True])
    np.testing.assert_array_equal(solution.joint_positions[:2], joints[:2])


def test_none_to_solve(robot, solver):
    solution = solver.solve(np.empty((0, 7)), np.empty((0, len(robot.arm))))
    assert solution.joint_positions.shape == (0, len(robot.arm))
    assert solution.feasible.shape == solution.position_error.shape == (0,)


@pytest.mark.parametrize(
    ("targets", "seeds", "max_joint_step", "message"),
    [
        ((1, 7), (3, "v"), None, r"^seeds must be of shape \(1, \d\), not \(3, \d\)"),
        ((3, 7), (1, "v"), None, r"^seeds must be of shape \(3, \d\), not \(1, \d\)"),
        ((2, 7), (2, 3), None, r"^seeds must be of shape \(2, \d\), not \(2, 3\)"),
        ((1, 7), ("v",), None, r"^seeds must be of shape \(1, \d\), not \(\d,\)"),
        ((2, 6), (2, "v"), None, r"^targets must be of shape \(n, 7\), not \(2, 6\)"),
        ((7,), (1, "v"), None, r"^targets must be of shape \(n, 7\), not \(7,\)"),
        ((2, 7), (2, "v"), (3,), r"^max_joint_step must be of shape \(\d,\), not \(3,\)"),
        ((2, 7), (2, "v"), (2, "v"), r"^max_joint_step must be of shape \(\d,\), not \(2, \d\)"),
        ((2, 7), (2, "v"), (0,), r"^max_joint_step must be of shape \(\d,\), not \(0,\)"),
    ],
)
def test_shapes_that_do_not_belong_together_are_refused(
    solver, targets, seeds, max_joint_step, message
):
    def ones(shape):
        return np.ones([len(solver.robot.arm) if size == "v" else size for size in shape])

    with pytest.raises(KinfeasError, match=message):
        solver.solve(
            ones(targets), ones(seeds), None if max_joint_step is None else ones(max_joint_step)
        )


def test_seed_beyond_the_limits(robot, exact_solver, draw):
    joints = draw_free(exact_solver, draw, 200)
    seeds = shuffled(joints) * 3.0 + 5.0
    solution = exact_solver.solve(forward(exact_solver.chain, joints), seeds)
    assert solution.feasible.mean() >= 0.99
    check_solutions(exact_solver, solution.joint_positions[solution.feasible])


def test_self_collision_matters_and_can_be_left_out(robot, draw):
    options = IkOptions(pose_tolerance=False, self_collision=False)
    blind, seeing = IkSolver(robot, options), IkSolver(robot, replace(options, self_collision=True))
    joints = draw(robot, 500)
    touching = joints[self_collides(blind.collision, joints)]
    targets = forward(blind.chain, touching)
    found, kept = blind.solve(targets, touching), seeing.solve(targets, touching)
    assert found.feasible.all()
    assert self_collides(blind.collision, found.joint_positions).all()  # the seeds themselves
    assert not self_collides(blind.collision, kept.joint_positions[kept.feasible]).any()


def test_leeway(robot, judge, draw):
    """Feasible if and only if what is left is within the robot's pose tolerance, and FK says the
    same."""
    if robot.pose_tolerance is None:
        pytest.skip("has no pose tolerance")
    solver = IkSolver(robot, IkOptions(self_collision=False))
    rng = np.random.default_rng(1)
    joints = draw(robot, 1000)
    targets = forward(solver.chain, joints)
    targets[:, :3] += rng.normal(scale=0.08, size=(1000, 3))
    targets[:, 3:] += rng.normal(scale=0.08, size=(1000, 4))
    targets[:, 3:] /= np.linalg.norm(targets[:, 3:], axis=1, keepdims=True)
    solution = solver.solve(targets, joints)
    within = solution.position_error <= robot.pose_tolerance.position
    within &= solution.rotation_error <= robot.pose_tolerance.rotation
    np.testing.assert_array_equal(solution.feasible, within)
    assert 100 < solution.feasible.sum() < 1000
    solved = solution.feasible
    missed = judge.miss(targets[solved], solution.joint_positions[solved])
    reported = np.stack([solution.position_error, solution.rotation_error], axis=1)[solved]
    np.testing.assert_allclose(reported, missed, rtol=0.0, atol=1e-9)
    assert reported[:, 0].max() > 0.05  # the pose tolerance is made use of
    metres, radians = distance(
        forward(solver.chain, solution.joint_positions[solved]), targets[solved]
    )
    np.testing.assert_allclose(metres, reported[:, 0], atol=1e-9)
    np.testing.assert_allclose(radians, reported[:, 1], atol=1e-7)


def test_what_a_configuration_brings_within_the_leeway_is_not_out_of_reach(robot, draw):
    if robot.pose_tolerance is None:
        pytest.skip("has no pose tolerance")
    solver = IkSolver(robot)
    joints = draw(robot, 2000)
    poses = forward(solver.chain, joints)
    turns = spatial.rotation(poses).as_matrix()
    chain, reach = solver.chain, solver._problem.reach
    lever = turns @ chain.ee_rotation.T @ chain.ee_offset
    out = poses[:, :3] - lever - reach[:3]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # Moved and turned as far as allowed, so that the last joint would have to lie farther out.
    axis = np.cross(out, lever)
    axis *= 0.999 * robot.pose_tolerance.rotation / np.linalg.norm(axis, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(axis).as_matrix() @ turns
    moved = poses[:, :3] + 0.999 * robot.pose_tolerance.position * out
    for turn, position in zip(turned, moved, strict=True):
        assert not _out_of_reach(solver._problem, (turn, position))


def test_an_arm_that_may_stay_is_never_without_a_solution(robot, draw):
    if robot.pose_tolerance is None:
        pytest.skip("has no pose tolerance")
    solver = IkSolver(robot, IkOptions(restarts=0))
    rng = np.random.default_rng(2)
    joints = draw(robot, 20_000)
    joints = joints[~self_collides(solver.collision, joints)]
    targets = forward(solver.chain, joints)
    targets[:, :3] += rng.normal(scale=0.05, size=(len(joints), 3))
    targets[:, 3:] += rng.normal(scale=0.05, size=(len(joints), 4))
    targets[:, 3:] /= np.linalg.norm(targets[:, 3:], axis=1, keepdims=True)
    metres, radians = distance(forward(solver.chain, joints), targets)
    may_stay = (metres <= robot.pose_tolerance.position) & (
        radians <= robot.pose_tolerance.rotation
    )
    assert may_stay.sum() > 5000
    for max_joint_step in (None, 0.1 * robot.max_joint_velocity):
        assert solver.solve(targets[may_stay], joints[may_stay], max_joint_step).feasible.all()


def test_spread_configurations_cover_the_limits(robot):
    joints = spread_configurations(robot, 512)
    lower, upper = robot.finite_joint_limits
    assert np.all((joints >= lower) & (joints <= upper))
    np.testing.assert_array_equal(joints, spread_configurations(robot, 512))
    assert not np.array_equal(joints, spread_configurations(robot, 512, seed=1))
    counts = [
        np.histogram(column, 8, (0, 1))[0] for column in ((joints - lower) / (upper - lower)).T
    ]
    assert np.min(counts) > 64 - 12


AFRESH = """
import hashlib
from kinfeas.core import registry
from kinfeas.robots.loading import load_robot
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver, spread_configurations

solver = IkSolver(load_robot("tiago"), IkOptions(self_collision=False))
joints = spread_configurations(solver.robot, 200)
found = solver.solve(forward(solver.chain, joints), joints[::-1])
print(hashlib.sha256(found.joint_positions.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_whoever_compiles_the_kernels_finds_what_others_find(tmp_path):
    """The first process compiles, without self-collision, and the second one loads that."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", AFRESH]
    first, second = (
        subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, timeout=240
        ).stdout
        for _ in range(2)
    )
    assert len(first) > 60
    assert second == first
