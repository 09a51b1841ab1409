import re

import numpy as np
import pytest

from kinfeas.core.checks.motion import CheckedMotion, ConformanceError
from kinfeas.core.errors import KinfeasError
from kinfeas.core.single_motion import batched
from kinfeas.core.spatial import IDENTITY
from kinfeas.plugins.linear import Linear

POSES, DT = np.tile(IDENTITY, (3, 1)), np.full(3, 0.1)


class Answers:
    """Gives the answers that it is made with."""

    def __init__(self, start=None, goal=None, twist=None, base=None):
        self.answers = {"start": start, "goal": goal, "twist": twist}
        if base is not None:
            self.base_pose = lambda state, target_pose: base

    def answer(self, name, sound):
        given = self.answers[name]
        if isinstance(given, BaseException):
            raise given
        return sound if given is None else given

    def start(self, ee_pose, target_pose, rngs):
        return self.answer("start", {"goal": target_pose.copy()})

    def goal_pose(self, state, target_pose):
        return self.answer("goal", state["goal"])

    def twist(self, state, ee_pose, target_pose, dt):
        return self.answer("twist", (np.zeros((3, 6)), state))


def ask(generator):
    motion = CheckedMotion(generator, "mine")
    state = motion.start(POSES, POSES, [np.random.default_rng(i) for i in range(3)])
    motion.goal_pose(state, POSES)
    motion.base_pose(state, POSES)
    return motion.twist(state, POSES, POSES, DT)


ZERO, STATE = np.zeros((3, 6)), {"goal": POSES.copy()}
TINY, HUGE = np.full((3, 6), 1e-300), np.full((3, 6), 1e200)
BAD = {
    "a list for a state": ({"start": [1]}, "must return a state from start that is a dict"),
    "rows that lack": ({"start": {"goal": POSES[:1]}}, "of leading axis 3, and 'goal' has shape"),
    "words": ({"start": {"goal": np.array(["a"] * 3)}}, "and 'goal' is not"),
    "a goal of twists": ({"goal": ZERO}, r"of shape \(3, 7\) from goal_pose, not \(3, 6\)"),
    "a goal of nothing": ({"goal": POSES * np.nan}, "numbers from goal_pose that are not finite"),
    "a long goal": ({"goal": POSES * 2.0}, "quaternion is not of unit length"),
    "no pair": ({"twist": ZERO}, "must return a pair from twist"),
    "a short twist": ({"twist": (ZERO[:, :3], STATE)}, r"not \(3, 3\)"),
    "a twist of words": ({"twist": (ZERO.astype(str), STATE)}, "from twist, not an array of <U"),
    "a twist of objects": ({"twist": (ZERO.astype(object), STATE)}, "not an array of object"),
    "a listed twist": ({"twist": (ZERO.tolist(), STATE)}, "from twist, not list"),
    "nan": ({"twist": (ZERO * np.nan, STATE)}, "numbers from twist that are not finite"),
    "both infinities": ({"twist": (ZERO + [np.inf, -np.inf] * 3, STATE)}, "not finite"),
    "a state that shrinks": ({"twist": (ZERO, {"goal": POSES[0]})}, "has shape"),
    "a state that goes": ({"twist": (ZERO, None)}, "that is a dict of numeric arrays, not a None"),
    "a state of objects": ({"twist": (ZERO, {"goal": POSES.astype(object)})}, "and 'goal' is not"),
    "a key that is no word": ({"start": {5: POSES}}, "numeric arrays by strings, and 5 is none"),
    "a new key that is none": ({"twist": (ZERO, {**STATE, 5: POSES})}, "and 5 is none"),
    "a state of words": ({"twist": (ZERO, {"goal": POSES.astype(str)})}, "and 'goal' is not"),
    "a short base": ({"base": POSES[:2]}, r"of shape \(3, 7\) from base_pose"),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_answers_are_refused(name):
    answers, sentence = BAD[name]
    with pytest.raises(ConformanceError, match=sentence) as caught:
        ask(Answers(**answers))
    assert str(caught.value).startswith("motion generator mine ")


@pytest.mark.parametrize("kind", [type(None), dict, type("Half", (Answers,), {"twist": None})])
def test_what_lacks_a_method_is_no_generator(kind):
    sentence = "^motion generator mine must have the methods start, goal_pose and twist; "
    with pytest.raises(ConformanceError, match=f"{sentence}{kind.__name__} lacks .*twist$"):
        CheckedMotion(kind(), "mine")


OLD = {
    "goal_pose": (lambda self, state: state["goal"], "state, target_pose", "state"),
    "twist": (
        lambda self, state, ee_pose, dt: (ZERO, state),
        "state, ee_pose, target_pose, dt",
        "state, ee_pose, dt",
    ),
    "base_pose": (lambda self, state: POSES, "state, target_pose", "state"),
}


@pytest.mark.parametrize("method", OLD)
def test_what_takes_other_parameters_is_no_generator(method):
    function, must, takes = OLD[method]
    sentence = f"motion generator mine must have the method {method}({must}), not {method}({takes})"
    with pytest.raises(TypeError, match=re.escape(sentence)) as caught:
        CheckedMotion(type("Old", (Answers,), {method: function})(), "mine")
    assert isinstance(caught.value, KinfeasError)


@pytest.mark.parametrize(
    ("goal", "sentence"),
    [
        (POSES * np.nan, "returns numbers from goal_pose that are not finite"),
        (POSES + np.array([np.inf, -np.inf, 0, 0, 0, 0, 0]), "from goal_pose that are not finite"),
        ((POSES * np.nan).astype(np.float32), "from goal_pose that are not finite"),
        (POSES.astype(object), r"shape \(3, 7\) from goal_pose, not an array of object"),
        (POSES.astype(str), r"shape \(3, 7\) from goal_pose, not an array of <U32"),
        (POSES[:2], r"of shape \(3, 7\) from goal_pose, not \(2, 7\)"),
        (POSES.tolist(), r"of shape \(3, 7\) from goal_pose, not list"),
    ],
)
def test_a_goal_is_looked_at_each_time(goal, sentence):
    generator = Answers()
    motion = CheckedMotion(generator, "mine")
    state = motion.start(POSES, POSES, [np.random.default_rng(i) for i in range(3)])
    motion.goal_pose(state, POSES)
    generator.answers["goal"] = goal
    with pytest.raises(ConformanceError, match=f"^motion generator mine .*{sentence}"):
        motion.goal_pose(state, POSES)


@pytest.mark.parametrize(
    "goal", [POSES, POSES.astype(np.float32), POSES.astype(int), POSES * 1e200]
)
def test_all_finite_goals_pass(goal):
    generator = Answers()
    motion = CheckedMotion(generator)
    state = motion.start(POSES, POSES, [np.random.default_rng(i) for i in range(3)])
    generator.answers["goal"] = goal
    assert motion.goal_pose(state, POSES) is goal


CHANGED = {
    "a key that goes": ({"x": "goes"}, r"\['x'\]"),
    "a key that comes": ({"velocity": np.zeros((3, 6))}, r"\['velocity'\]"),
    "a shape": ({"x": np.zeros((3, 3))}, r"\['x'\]"),
    "a type": ({"x": np.full(3, 0.5, dtype=np.float32)}, r"\['x'\]"),
    "two types": ({"x": np.zeros(3, dtype=int), "goal": POSES.astype(int)}, r"\['goal', 'x'\]"),
}


def changed(state, changes):
    after = {**state, **changes}
    return {key: value for key, value in after.items() if not isinstance(value, str)}


@pytest.mark.parametrize("name", CHANGED)
def test_a_state_keeps_its_layout(name):
    changes, keys = CHANGED[name]
    state = {"goal": POSES.copy(), "x": np.zeros(3)}
    refused = rf"^motion generator mine changes the keys, shapes or types of its state: {keys}$"
    generator = Answers(start=state, twist=(ZERO, changed(state, changes)))
    with pytest.raises(ConformanceError, match=refused) as caught:
        ask(generator)
    assert caught.value.rule == "layout"
    motion, rngs = CheckedMotion(generator, "mine"), [np.random.default_rng(0)] * 3
    motion.start(POSES, POSES, rngs)
    generator.answers["start"] = changed(state, changes)
    with pytest.raises(ConformanceError, match=refused):
        motion.start(POSES, POSES, rngs)


@pytest.mark.parametrize("name", CHANGED)
def test_a_run_that_goes_on_knows_the_layout_from_its_state(name):
    changes, keys = CHANGED[name]
    state = {"goal": POSES.copy(), "x": np.zeros(3)}
    motion = CheckedMotion(Answers(twist=(ZERO, state)), "mine")
    assert motion.twist(state, POSES, POSES, DT)[1] is state
    motion = CheckedMotion(Answers(twist=(ZERO, changed(state, changes))), "mine")
    with pytest.raises(ConformanceError, match=f"its state: {keys}$"):
        motion.twist(state, POSES, POSES, DT)


def test_no_motion_may_have_no_keys():
    motion, none = CheckedMotion(batched(Hover)()), np.zeros((0, 7))
    for poses in (none, POSES, none):
        rngs = [np.random.default_rng(0)] * len(poses)
        state = motion.start(poses, poses, rngs)
        assert motion.twist(state, poses, poses, DT[: len(poses)])[0].shape == (len(poses), 6)


class Hover:
    """Stands still."""

    def start(self, ee_pose, target_pose, rng):
        return {"goal": ee_pose}

    def goal_pose(self, state, target_pose):
        return state["goal"]

    def twist(self, state, ee_pose, target_pose, dt):
        return np.zeros(6), state


@pytest.mark.parametrize("twist", [ZERO, TINY, HUGE, ZERO.astype(int), ZERO.astype(np.float32)])
def test_all_finite_numbers_pass(twist):
    assert ask(Answers(twist=(twist, STATE)))[0] is twist


@pytest.mark.parametrize("method", ["start", "goal", "twist"])
def test_what_its_code_raises_names_it(method):
    with pytest.raises(KinfeasError, match=rf"^motion generator mine fails in {method}\w*: KeyErr"):
        ask(Answers(**{method: KeyError("x")}))


class OwnError(Exception):
    """What a plugin's author may think up."""


def test_errors_may_be_of_any_class():
    with pytest.raises(KinfeasError, match=r"fails in twist: OwnError: oh .*line \d+"):
        ask(Answers(twist=OwnError("oh")))


def test_it_cannot_end_the_program():
    with pytest.raises(KinfeasError, match="fails in twist: SystemExit: 5"):
        ask(Answers(twist=SystemExit(5)))


def test_answers_come_through_unchanged():
    motion, linear = CheckedMotion(Linear()), Linear()
    rngs = [np.random.default_rng(i) for i in range(3)]
    state, target = motion.start(POSES, POSES + np.eye(7)[0], rngs), POSES + np.eye(7)[0]
    assert motion.subject == "motion generator Linear"
    twist, _ = motion.twist(state, POSES, target, DT)
    assert np.array_equal(twist, linear.twist(state, POSES, target, DT)[0])
    assert np.array_equal(motion.goal_pose(state, target), target)
    assert np.isnan(motion.base_pose(state, POSES)).all()
    assert not motion.demonstrated
    assert CheckedMotion(Answers(base=POSES)).demonstrated
    assert motion.start(POSES[:0], POSES[:0], []) == {}
