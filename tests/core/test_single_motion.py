import numpy as np
import pytest

from kinfeas.core.checks import CheckedMotion
from kinfeas.core.motion import WAYPOINTS, WholeBodyPath
from kinfeas.core.single_motion import batched
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import twist_between
from kinfeas.testing import check_motion_generator
from tests.builders import random_poses, rngs


class Approach:
    """Moves to a random position above the target at constant speed, and counts its steps."""

    def start(self, ee_pose, target_pose, rng):
        goal = target_pose.copy()
        goal[2] += rng.uniform(0.0, 0.1)
        return {"goal": goal, "steps": 0, "seconds": 0.0}

    def goal_pose(self, state, target_pose):
        return state["goal"]

    def twist(self, state, ee_pose, target_pose, dt):
        twist = twist_between(ee_pose, state["goal"], dt)
        fastest = max(np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]), 0.09)
        state["steps"] += 1
        return twist * 0.09 / fastest, {**state, "seconds": dt}


Batched = batched(Approach)


@pytest.mark.parametrize("n", [0, 1, 5])
def test_each_row_is_the_single_motion(n):
    start, target, dt = random_poses(n, 0), random_poses(n, 1), 0.1 + np.arange(n)
    single, generator = Approach(), Batched()
    state = generator.start(start, target, rngs(n))
    twist, after = generator.twist(state, start, target, dt)
    goal = generator.goal_pose(state, target)
    assert (goal.shape, twist.shape) == ((n, 7), (n, 6))
    for i, rng in enumerate(rngs(n)):
        alone = single.start(start[i], target[i], rng)
        assert np.array_equal(goal[i], single.goal_pose(alone, target[i]))
        assert np.array_equal(twist[i], single.twist(alone, start[i], target[i], dt[i])[0])
    if n:
        np.testing.assert_array_equal(state["steps"], np.zeros(n))
        np.testing.assert_array_equal(after["steps"], np.ones(n))
        np.testing.assert_array_equal(after["seconds"], dt)


def test_batched_generators_pass_the_conformance_check():
    check_motion_generator(Batched())


def test_a_motion_with_an_end_of_its_own_ends_row_by_row():
    class Timed(Approach):
        def finished(self, state, target_pose):
            return state["steps"] >= 2

    generator, target = batched(Timed)(), random_poses(3, 1)
    state = generator.start(random_poses(3, 0), target, rngs(3))
    finished = generator.finished({**state, "steps": np.array([0.0, 2.0, 1.0])}, target)
    assert finished.dtype == np.bool_
    assert finished.tolist() == [False, True, False]
    assert generator.finished({}, np.zeros((0, 7))).shape == (0,)
    assert not hasattr(Batched(), "finished")


def test_optional_methods_are_called_row_by_row():
    class Careful(Approach):
        def replan(self, state, ee_pose, target_pose, solids):
            return {**state, "steps": solids.pose[0, 0, 0]}

        def follow(self, state, ee_pose, target_pose, path):
            return {**state, "steps": 7}, np.tile(path.robot[-1], (WAYPOINTS, 1))

        def robot_ahead(self, state, waypoints, seconds):
            return waypoints[: len(seconds)] + seconds[:, np.newaxis]

        def ahead(self, state, ee_pose, target_pose, distances):
            return np.tile(target_pose, (len(distances), 1))

    motion, start, target = CheckedMotion(batched(Careful)()), random_poses(2, 0), random_poses(2)
    state = motion.start(start, target, rngs(2))
    solids = Solids.empty(2, 1)
    solids.pose[:, 0, 0] = 3.0, 4.0
    assert motion.replan(state, start, target, solids)["steps"].tolist() == [3.0, 4.0]
    paths = [WholeBodyPath(pose[np.newaxis], np.full((1, 5), row), np.zeros(0))
             for row, pose in enumerate(start)]  # fmt: skip
    followed, waypoints = motion.follow(state, start, target, paths)
    assert followed["steps"].tolist() == [7.0, 7.0]
    robot = motion.robot_ahead(state, waypoints, np.array([0.0, 1.0]))
    assert robot[:, :, 0].tolist() == [[0.0, 1.0], [1.0, 2.0]]
    poses = motion.ahead(state, start, target, np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(poses, np.tile(target[:, np.newaxis], (1, 3, 1)))
