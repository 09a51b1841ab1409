import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.planning.placement import STAGES, connected, reachable


def made_by_the_arm(solver, count):
    rng = np.random.default_rng(4)
    joints = spread_configurations(solver.robot, 4 * count, seed=9)
    joints = joints[~self_collides(solver.collision, joints)][:count]
    base = spatial.planar_pose(*rng.uniform(-3.0, 3.0, (3, len(joints))))
    return spatial.compose(base, forward(solver.chain, joints))


def at_height(count, low, high):
    rng = np.random.default_rng(5)
    position = np.stack(
        [*rng.uniform(-3.0, 3.0, (2, count)), rng.uniform(low, high, count)], axis=1
    )
    return spatial.make_pose(position, Rotation.random(count, rng=rng))


def by_chance(solver, goals, tries):
    rng = np.random.default_rng(6)
    reached = np.zeros(len(goals), dtype=bool)
    home = np.tile(solver.robot.home["home"], (tries, 1))
    for i, goal in enumerate(goals):
        distance = np.sqrt(rng.uniform(0.0, 1.2, tries))
        bearing, heading = rng.uniform(-np.pi, np.pi, (2, tries))
        x, y = goal[0] + distance * np.cos(bearing), goal[1] + distance * np.sin(bearing)
        targets = spatial.relative(np.tile(goal, (tries, 1)), spatial.planar_pose(x, y, heading))
        reached[i] = solver.solve(targets, home).feasible.any()
    return reached


def test_poses_of_the_arm_are_reachable(robot):
    # Arms of few joints reach a pose exactly from hardly any base pose.
    nearly = IkOptions(pose_tolerance=False, position_tolerance=0.025, rotation_tolerance=0.2)
    solver = IkSolver(robot, nearly)
    result = reachable(solver, made_by_the_arm(solver, 30))
    assert result.reached.all()
    assert result.share.low < result.share.value == 1.0
    assert result.convergence[0] > 0.9  # the best proposals come first


def test_finds_all_that_random_base_poses_find(hsr):
    solver, goals = IkSolver(hsr), at_height(20, 0.1, 1.4)
    result = reachable(solver, goals)
    assert not np.any(by_chance(solver, goals, 300) & ~result.reached)
    assert len(result.convergence) == len(STAGES)
    assert list(result.convergence) == sorted(result.convergence)
    assert result.convergence[-1] == result.share.value == result.reached.mean()
    # Neither the place on the floor nor the other goals matter.
    moved = spatial.compose(spatial.planar_pose(*np.full((3, 20), 2.0)), goals)
    np.testing.assert_array_equal(reachable(solver, moved).reached, result.reached)
    np.testing.assert_array_equal(reachable(solver, goals[3:7]).reached, result.reached[3:7])


START, BEYOND, BESIDE = np.zeros(2), [3.0, 0.0], [0.0, 3.0]


def fence(gap):
    """Return walls around a square of 4 m, with a gap on the side towards x."""
    half, solids = (4.0 - gap) / 4.0, Solids.empty(1, 5)
    side = gap / 2.0 + half
    solids.pose[0, :, :2] = [[2, side], [2, -side], [-2, 0], [0, 2], [0, -2]]
    solids.size[0] = [*[[0.05, half, 0, 1]] * 2, [0.05, 2, 0, 1], *[[2, 0.05, 0, 1]] * 2]
    return solids


@pytest.mark.parametrize(("gap", "open_"), [(1.2, True), (0.85, True), (0.5, False), (0.0, False)])
def test_a_disc_passes_gaps_that_are_wide_enough(gap, open_):
    positions = np.array([BEYOND, BESIDE, [1.0, 1.0]])
    reached = connected(fence(gap), START, positions, (0.4, 0.0))
    np.testing.assert_array_equal(reached, [open_, open_, True])


def test_solids_above_a_disc_do_not_block_it():
    solids = fence(0.0)
    solids.size[..., 2] = 0.5
    assert connected(solids, START, np.array([BEYOND]), (0.4, 0.0)).all()
