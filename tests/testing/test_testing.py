import sys

import numpy as np
import pytest

from kinfeas.core.spatial import twist_between
from kinfeas.testing import RULES, ConformanceError, check_motion_generator, examine
from kinfeas.testing.rules import Trial


class Good:
    """A plain motion at constant speed; each bad generator below breaks one rule of it."""

    def start(self, ee_pose, target_pose, rngs):
        jitter = np.array([rng.uniform(-0.01, 0.01, 3) for rng in rngs]).reshape(-1, 3)
        goal = target_pose.copy()
        goal[:, :3] += jitter
        return {"goal": goal, "time": np.zeros(len(goal))}

    def goal_pose(self, state, target_pose):
        return state["goal"]

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, state["goal"], dt)
        speed = np.maximum(*(np.linalg.norm(part, axis=-1) for part in (way[:, :3], way[:, 3:])))
        share = np.minimum(1.0, 0.099 / np.maximum(speed, 1e-12))
        return way * share[:, np.newaxis], {**state, "time": state["time"] + dt}


def after_twist(change):
    class Changed(Good):
        def twist(self, state, ee_pose, target_pose, dt):
            return change(*super().twist(state, ee_pose, target_pose, dt))

    return Changed


class KeepsTheTarget(Good):
    def start(self, ee_pose, target_pose, rngs):
        return {**super().start(ee_pose, target_pose, rngs), "goal": target_pose}


def with_goal(change):
    class Changed(Good):
        def goal_pose(self, state, target_pose):
            return change(state["goal"], state["time"])

    return Changed


class WritesIntoThePose(Good):
    def twist(self, state, ee_pose, target_pose, dt):
        answer = super().twist(state, ee_pose, target_pose, dt)
        ee_pose *= 1.01
        return answer


class OwnRandomness(Good):
    def __init__(self):
        self.rng = np.random.default_rng(0)

    def start(self, ee_pose, target_pose, rngs):
        return super().start(ee_pose, target_pose, [self.rng] * len(rngs))


class NanAtTheGoal(Good):
    def start(self, ee_pose, target_pose, rngs):
        return {"goal": target_pose.copy()}

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, state["goal"], dt)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = 0.05 / np.linalg.norm(way[:, :3], axis=-1, keepdims=True)
            return np.clip(way * share, -0.05, 0.05), state


class WritesIntoTheState(Good):
    def twist(self, state, ee_pose, target_pose, dt):
        state["time"] += dt
        return super().twist(state, ee_pose, target_pose, dt)


class OneStepForAll(Good):
    def twist(self, state, ee_pose, target_pose, dt):
        return super().twist(state, ee_pose, target_pose, np.full(len(dt), dt[0]))


class RemembersTheLongRun(Good):
    """Slows down for good, too late for two calls in a row to show it."""

    def __init__(self):
        self.calls = 0

    def twist(self, state, ee_pose, target_pose, dt):
        self.calls += 1
        twist, state = super().twist(state, ee_pose, target_pose, dt)
        return twist * (1.0 if self.calls < 600 else 0.9), state


def leave(twist, state):
    twist[state["time"] > 100.0] = [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]
    return twist, state


class FinishedForAll(Good):
    def finished(self, state, target_pose):
        return True


class Circle(Good):
    """Goes to the goal, then once around a circle that begins and ends there."""

    def twist(self, state, ee_pose, target_pose, dt):
        twist, after = super().twist(state, ee_pose, target_pose, dt)
        turn = 2.0 * np.pi * np.clip((state["time"] - 80.0) / 20.0, 0.0, 1.0)
        around = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
        begun = (turn > 0.0) & (turn < 2.0 * np.pi)
        twist[begun, :3] = 0.08 * around[begun]
        twist[begun, 3:] = 0.0
        return twist, after


class FinishedCircle(Circle):
    def finished(self, state, target_pose):
        return state["time"] >= 100.0


class NeedsARestingTarget(Good):
    def start(self, ee_pose, target_pose, rngs):
        return {**super().start(ee_pose, target_pose, rngs), "target": target_pose.copy()}

    def twist(self, state, ee_pose, target_pose, dt):
        twist, after = super().twist(state, ee_pose, target_pose, dt)
        twist[np.any(state["target"] != target_pose, axis=1)] = np.nan
        return twist, after


class ForgetsItsState(Good):
    def replan(self, state, ee_pose, target_pose, solids):
        return {"goal": target_pose[: len(solids.pose)]}


class LooksOneStepAhead(Good):
    def ahead(self, state, ee_pose, target_pose, distances):
        return state["goal"]


def bump(goal, time):
    return goal + 1e-3 * np.outer(np.maximum(0.0, 60.0 - time) * time, [0, 0, 1, 0, 0, 0, 0])


TooFast = after_twist(lambda twist, state: (twist * [2, 2, 2, 1, 1, 1], state))
TurnsTooFast = after_twist(lambda twist, state: (twist * [1, 1, 1, 2, 2, 2], state))
TwistOfWrongShape = after_twist(lambda twist, state: (twist[:, :3], state))
BAD = {
    "twist of wrong shape": ("form", TwistOfWrongShape),
    "NaN at the goal": ("form", NanAtTheGoal),
    "other keys": ("layout", after_twist(lambda twist, state: (twist, {**state, "last": twist}))),
    "target kept": ("copies", KeepsTheTarget),
    "state written": ("copies", WritesIntoTheState),
    "pose written": ("copies", WritesIntoThePose),
    "own randomness": ("repeatable", OwnRandomness),
    "one step for all": ("rows", OneStepForAll),
    "long run": ("restart", RemembersTheLongRun),
    "goal not of unit length": ("quaternions", with_goal(lambda goal, time: 2.0 * goal)),
    "moving goal": (
        "goal",
        with_goal(lambda goal, time: goal + 1e-3 * np.outer(time, [1, 0, 0, 0, 0, 0, 0])),
    ),
    "goal that comes back": ("goal", with_goal(bump)),
    "NaN for a target that moves": ("form", NeedsARestingTarget),
    "one pose ahead": ("form", LooksOneStepAhead),
    "other keys after planning": ("layout", ForgetsItsState),
    "too fast": ("velocity", TooFast),
    "turns too fast": ("angular_velocity", TurnsTooFast),
    "never arrives": ("arrival", after_twist(lambda twist, state: (twist * 0.01, state))),
    "leaves again": ("end", after_twist(leave)),
    "finished for all": ("form", FinishedForAll),
}


@pytest.mark.parametrize("dt", [0.1, 0.02])
def test_a_good_generator_passes(dt):
    check_motion_generator(Good(), dt=dt)


@pytest.mark.parametrize("name", BAD)
def test_each_rule_is_checked(name):
    rule, bad = BAD[name]
    with pytest.raises(ConformanceError, match=f"^motion generator {bad.__name__} ") as caught:
        check_motion_generator(bad())
    assert caught.value.rule == rule
    found = {one.rule: one.broken for one in examine(bad(), name="mine") if one.broken}
    assert found[rule] == str(caught.value).replace(bad.__name__, "mine")


def test_all_rules_have_a_bad_generator():
    assert {rule for rule, _ in BAD.values()} == set(RULES)


def test_examine_tells_all_rules_of_a_good_generator():
    steps = []
    findings = examine(Good(), Trial(duration=30.0, dt=0.1), on_step=lambda: steps.append(1))
    assert len(steps) == 300
    assert [one.rule for one in findings] == list(RULES)
    assert all(one.checked for one in findings)
    assert [one.rule for one in findings if one.broken] in ([], ["arrival"])
    assert all(one.kept for one in examine(Good()))


@pytest.mark.parametrize(("call", "name"), [
    (lambda: {}["gaol"], "KeyError"), (lambda: sys.exit(0), "SystemExit"),
    (lambda: np.linalg.inv(np.zeros((2, 2))), "LinAlgError"),
])  # fmt: skip
def test_examine_reports_exceptions(call, name):
    class Raises(Good):
        def twist(self, state, ee_pose, target_pose, dt):
            call()

    form = examine(Raises())[0]
    assert form.broken.startswith(f"motion generator Raises raises {name}")
    assert "test_testing.py, line" in form.broken


def test_a_generator_that_computes_in_float32_is_told_to_use_float64():
    def rounded(twist, state):
        return (twist * (1.0 + 1e-7 * (len(twist) > 1))).astype(np.float32), state

    with pytest.raises(ConformanceError, match="float64"):
        check_motion_generator(after_twist(rounded)())


def test_a_motion_that_passes_its_goal_says_when_it_is_finished():
    check_motion_generator(FinishedCircle())
    findings = examine(Circle())
    assert [one.rule for one in findings if one.broken] == ["end"]
