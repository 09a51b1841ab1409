from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.backend import RobotState
from kinfeas.core.checks import CheckedMotion, ConformanceError, check_array, check_state
from kinfeas.core.errors import KinfeasError, plugin_note, raised_by
from kinfeas.core.spatial import IDENTITY

SHAPE = (3, 6)
SOUND = RobotState(np.tile(IDENTITY, (3, 1)), np.zeros((3, 5)))


@pytest.mark.parametrize(
    "value", [np.zeros((3, 5)), [[0.0] * 6] * 3, np.zeros(SHAPE, object), np.full(SHAPE, np.nan)]
)
def test_other_arrays_raise_errors(value):
    with pytest.raises(KinfeasError, match=r"^mine "):
        check_array(value, SHAPE, "mine")
    check_array(np.ones(SHAPE, dtype=int), SHAPE, "mine")
    check_array(np.full(SHAPE, np.nan), SHAPE, "mine", finite=False)


STATES = {
    "state": lambda s: None,
    "base_pose": lambda s: replace(s, base_pose=s.base_pose[:2]),
    "joint_positions": lambda s: replace(s, joint_positions=s.joint_positions * np.nan),
    "ee_in_base": lambda s: replace(s, ee_in_base=np.zeros((3, 6))),
    "base_twist": lambda s: replace(s, base_twist=np.zeros((3, 7))),
    "age": lambda s: replace(s, age=0.1),
    "true_state": lambda s: replace(s, true_state=replace(s, base_pose=None)),
}


@pytest.mark.parametrize("name", STATES)
def test_other_states_raise_errors(name):
    check_state(replace(SOUND, age=np.full(3, np.nan), true_state=SOUND), 3, 5, "mine")
    with pytest.raises(KinfeasError, match="^mine.*" + ("RobotState" if name == "state" else name)):
        check_state(STATES[name](SOUND), 3, 5, "mine")


@pytest.mark.parametrize("error", [StopIteration(), SystemExit(0)])
def test_exceptions_keep_their_type_and_name_the_plugin(error):
    assert raised_by(error) is None
    with pytest.raises(type(error)) as caught, plugin_note("adapter Mine"):
        raise error
    assert caught.value is error
    assert raised_by(error) == "adapter Mine"


POSES, DT = np.tile(IDENTITY, (3, 1)), np.full(3, 0.1)
ZERO, STATE = np.zeros((3, 6)), {"goal": POSES.copy(), "x": np.zeros(3)}


class Answers:
    def __init__(self, start=STATE, goal=POSES, twist=(ZERO, STATE), base=None, ahead=None):
        self.answers = {"start": start, "goal": goal, "twist": twist}
        if base is not None:
            self.base_pose = lambda state, target_pose: base
        if ahead is not None:
            self.ahead = lambda state, ee_pose, target_pose, distances: ahead

    def answer(self, name):
        return self.answers[name]

    def start(self, ee_pose, target_pose, rngs):
        return self.answer("start")

    def goal_pose(self, state, target_pose):
        return self.answer("goal")

    def twist(self, state, ee_pose, target_pose, dt):
        return self.answer("twist")


def start(motion):
    return motion.start(POSES, POSES, [np.random.default_rng(i) for i in range(3)])


def ask(generator):
    motion = CheckedMotion(generator, "mine")
    state = start(motion)
    motion.base_pose(state, POSES)
    motion.twist(state, POSES, POSES, DT)
    motion.ahead(state, POSES, POSES, np.ones(2))


BAD = {
    "a list for a state": ({"start": [1]}, "start"),
    "missing rows": ({"start": {"goal": POSES[:1]}}, "goal"),
    "words": ({"start": {"goal": np.array(["a"] * 3)}}, "goal"),
    "a goal of twists": ({"goal": ZERO}, "goal_pose"),
    "a long goal": ({"goal": POSES * 2.0}, "goal_pose"),
    "no pair": ({"twist": ZERO}, "twist"),
    "a short twist": ({"twist": (ZERO[:, :3], STATE)}, "twist"),
    "nan": ({"twist": (ZERO * np.nan, STATE)}, "twist"),
    "no next state": ({"twist": (ZERO, None)}, "twist"),
    "a short base": ({"base": POSES[:2]}, "base_pose"),
    "one pose ahead": ({"ahead": POSES}, "ahead"),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_answers_raise_errors(name):
    answers, word = BAD[name]
    with pytest.raises(ConformanceError, match=f"^motion generator mine .*{word}"):
        ask(Answers(**answers))


def test_answers_are_checked_after_each_start_or_at_every_step():
    generator = Answers()
    motion = CheckedMotion(generator)
    state = start(motion)
    motion.twist(state, POSES, POSES, DT)
    generator.answers["twist"] = (ZERO, {"clock": ZERO})
    motion.twist(state, POSES, POSES, DT)
    start(motion)
    with pytest.raises(ConformanceError):
        motion.twist(state, POSES, POSES, DT)
    generator.answers["twist"] = (ZERO, STATE)
    strict = CheckedMotion(generator, every_step=True)
    strict.twist(start(strict), POSES, POSES, DT)
    generator.answers["twist"] = (ZERO, {"clock": ZERO})
    with pytest.raises(ConformanceError):
        strict.twist(state, POSES, POSES, DT)


def test_poses_and_twists_that_are_not_finite_name_the_generator_at_each_step():
    generator = Answers()
    motion = CheckedMotion(generator, "mine")
    state = start(motion)
    motion.twist(state, POSES, POSES, DT)
    generator.answers |= {"twist": (ZERO * np.nan, STATE), "goal": POSES * np.nan}
    for method in (
        lambda: motion.twist(state, POSES, POSES, DT),
        lambda: motion.goal_pose(state, POSES),
    ):
        with pytest.raises(ConformanceError, match="generator mine"):
            method()
