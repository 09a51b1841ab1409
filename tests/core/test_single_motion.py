import numpy as np
import pytest

from kinfeas.core.checks import ConformanceError
from kinfeas.core.single_motion import batched
from kinfeas.core.spatial import twist_between
from kinfeas.testing import check_motion_generator
from tests.builders import random_poses, rngs


class Approach:
    """Goes to a random spot above the target, straight, at constant speed."""

    def start(self, ee_pose, target_pose, rng):
        goal = target_pose.copy()
        goal[2] += rng.uniform(0.0, 0.1)
        return {"goal": goal, "steps": 0}

    def goal_pose(self, state, target_pose):
        return state["goal"]

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, self.goal_pose(state, target_pose), dt)
        fastest = max(np.linalg.norm(way[:3]), np.linalg.norm(way[3:]), 0.09)
        state["steps"] += 1
        return way * 0.09 / fastest, state


Batched = batched(Approach)


@pytest.mark.parametrize("n", [1, 5])
def test_each_row_is_the_single_motion(n):
    start, target = random_poses(n, 0), random_poses(n, 1)
    single, generator = Approach(), Batched()
    state = generator.start(start, target, rngs(n))
    twist, after = generator.twist(state, start, target, np.full(n, 0.1))
    assert twist.shape == (n, 6)
    goal = generator.goal_pose(state, target)
    assert goal.shape == (n, 7)
    for i, rng in enumerate(rngs(n)):
        alone = single.start(start[i], target[i], rng)
        assert np.array_equal(goal[i], single.goal_pose(alone, target[i]))
        assert np.array_equal(twist[i], single.twist(alone, start[i], target[i], 0.1)[0])
    assert np.array_equal(state["steps"], np.zeros(n))
    assert np.array_equal(after["steps"], np.ones(n))


def test_a_motion_with_an_end_of_its_own_says_row_by_row_when_it_is_there():
    class Timed(Approach):
        def finished(self, state, target_pose):
            return state["steps"] >= 2

    generator = batched(Timed)()
    start, target = random_poses(3, 0), random_poses(3, 1)
    state = generator.start(start, target, rngs(3))
    finished = generator.finished({**state, "steps": np.array([0.0, 2.0, 1.0])}, target)
    assert finished.dtype == np.bool_
    assert finished.tolist() == [False, True, False]
    assert generator.finished({}, np.zeros((0, 7))).shape == (0,)
    assert not hasattr(Batched(), "finished")


class Straight:
    """Needs no state: the target is an input of each call."""

    def start(self, ee_pose, target_pose, rng):
        return {}

    def goal_pose(self, state, target_pose):
        return target_pose

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, target_pose, dt)
        fastest = max(np.linalg.norm(way[:3]), np.linalg.norm(way[3:]), 0.09)
        return way * 0.09 / fastest, state


def test_a_state_may_be_empty_and_so_may_a_batch():
    check_motion_generator(batched(Straight)())
    none = np.zeros((0, 7))
    state = Batched().start(none, none, [])
    assert Batched().twist(state, none, none, np.zeros(0))[0].shape == (0, 6)
    assert Batched().goal_pose(state, none).shape == (0, 7)


def test_each_row_has_its_own_dt():
    seconds = []

    class Asks(Straight):
        def twist(self, state, ee_pose, target_pose, dt):
            seconds.append(dt)
            return super().twist(state, ee_pose, target_pose, dt)

    batched(Asks)().twist({}, random_poses(2, 0), random_poses(2, 1), np.array([0.1, 100.0]))
    assert seconds == [0.1, 100.0]


def test_a_twist_of_one_number_is_no_twist():
    class Number(Straight):
        def twist(self, state, ee_pose, target_pose, dt):
            return 0.05, state

    with pytest.raises(ConformanceError, match="shape"):
        check_motion_generator(batched(Number)())
