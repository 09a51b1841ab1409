import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.reachability import STAGES, at_goals, reachable
from kinfeas.kinematics.self_collision import self_collides


def made_by_the_arm(solver, count):
    """Return EE poses that the arm takes on, seen from bases here and there."""
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
    """Return which goals some of many base poses drawn at random reaches."""
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


def test_what_the_arm_can_do_is_reachable(robot):
    # Few joints reach a pose exactly from hardly any base pose, so that nearly has to do.
    nearly = IkOptions(pose_tolerance=False, position_tolerance=0.025, rotation_tolerance=0.2)
    solver = IkSolver(robot, nearly)
    found = reachable(solver, made_by_the_arm(solver, 40))
    assert found.reached.all()
    assert found.share.value == 1.0
    assert found.share.low < 1.0


def test_leeway_is_for_the_way_and_not_for_goals(robot):
    asked, exact = IkOptions(restarts=6), IkOptions(pose_tolerance=False)
    found = at_goals(robot, asked)
    assert at_goals(robot, exact) is exact
    if robot.pose_tolerance is None:
        assert found is asked
    else:
        assert (found.pose_tolerance, found.position_tolerance, found.restarts) == (False, 0.025, 6)


def test_what_is_out_of_reach_is_not(solver):
    found = reachable(solver, at_height(5, 2.5, 3.0), stages=(4, 16))
    assert not found.reached.any()
    assert found.convergence == (0.0, 0.0)
    assert found.share.value == 0.0


def test_finds_all_that_random_base_poses_find(solver):
    goals = at_height(20, 0.1, 1.4)
    found = reachable(solver, goals).reached
    assert not np.any(by_chance(solver, goals, 300) & ~found)


def test_goals_may_be_anywhere_on_the_floor(solver):
    goals = at_height(10, 0.3, 1.2)
    moved = spatial.compose(spatial.planar_pose(*np.full((3, 10), 2.0)), goals)
    np.testing.assert_array_equal(
        reachable(solver, goals).reached, reachable(solver, moved).reached
    )


def test_is_deterministic_and_goals_do_not_depend_on_each_other(solver):
    goals = at_height(12, 0.1, 1.5)
    first, again = reachable(solver, goals), reachable(solver, goals)
    np.testing.assert_array_equal(first.reached, again.reached)
    assert first.convergence == again.convergence
    np.testing.assert_array_equal(reachable(solver, goals[3:7]).reached, first.reached[3:7])


def test_convergence_rises_to_the_share(solver):
    found = reachable(solver, at_height(30, 0.1, 1.6))
    assert len(found.convergence) == len(STAGES)
    assert list(found.convergence) == sorted(found.convergence)
    assert found.convergence[-1] == found.share.value == found.reached.mean()
    assert found.share.low <= found.share.value <= found.share.high


@pytest.mark.parametrize("height", [0.7, 3.0])
def test_tells_how_far_it_is(solver, height):
    done = []
    reachable(solver, at_height(6, height, height + 0.1), stages=(2, 4, 8), on_done=done.append)
    assert sum(done) <= 1.0 + 1e-9
    if height > 2.0:
        assert sum(done) == pytest.approx(1.0)
