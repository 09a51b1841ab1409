"""A generator written for one motion becomes one for n."""

import inspect

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.single_motion import batched
from kinfeas.core.spatial import IDENTITY, Array, make_pose, rotation, twist_between
from kinfeas.testing import check_motion_generator


class Approach:
    """Goes to a random spot above the target, straight, at constant speed."""

    def __init__(self, *, height: float = 0.1, speed: float = 0.09) -> None:
        if height < 0.0:
            raise KinfeasError(f"height must be at least 0, not {height}")
        self.height, self.speed = height, speed

    def start(self, ee_pose, target_pose, rng):
        goal = target_pose.copy()
        goal[2] += rng.uniform(0.0, self.height)
        return {"goal": goal, "steps": 0}

    def goal_pose(self, state, target_pose):
        return state["goal"]

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, self.goal_pose(state, target_pose), dt)
        fastest = max(np.linalg.norm(way[:3]), np.linalg.norm(way[3:]), self.speed)
        state["steps"] += 1
        return way * self.speed / fastest, state


Batched = batched(Approach)


def poses(n, seed):
    rng = np.random.default_rng(seed)
    turned = np.tile(IDENTITY, (n, 1))
    turned[:, 3:] = rng.normal(size=(n, 4))
    return make_pose(rng.uniform(-1.0, 1.0, (n, 3)), rotation(turned))


def rngs(n):
    return [np.random.default_rng(i) for i in range(n)]


@pytest.mark.parametrize("n", [1, 5])
def test_each_row_is_the_single_motion(n):
    start, target = poses(n, 0), poses(n, 1)
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


def test_has_name_documentation_and_constructor_of_its_class():
    for name in ("__name__", "__qualname__", "__module__", "__doc__"):
        assert getattr(Batched, name) == getattr(Approach, name)
    assert inspect.signature(Batched) == inspect.signature(Approach)
    assert Batched(height=0.3).single.height == 0.3
    with pytest.raises(KinfeasError, match="height"):
        Batched(height=-1)


class Growing(Approach):
    """Has a path that is longer where the way is longer."""

    def start(self, ee_pose: Array, target_pose: Array, rng):
        points = 2 + int(10 * np.linalg.norm(ee_pose - target_pose))
        return {"goal": target_pose, "path": np.zeros((points, 3))}


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

    batched(Asks)().twist({}, poses(2, 0), poses(2, 1), np.array([0.1, 100.0]))
    assert seconds == [0.1, 100.0]


class WordInState(Approach):
    def start(self, ee_pose, target_pose, rng):
        return {**super().start(ee_pose, target_pose, rng), "way": "up"}


@pytest.mark.parametrize("single", [WordInState, Growing])
def test_invalid_answers_raise(single):
    generator = batched(single)()
    with pytest.raises(ValueError, match=r"\w"):
        state = generator.start(poses(5, 0), poses(5, 1), rngs(5))
        generator.twist(state, poses(5, 0), poses(5, 1), np.full(5, 0.1))
