import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core import registry
from kinfeas.core.backend import (
    RealTimeBackend,
    Resumable,
    RobotState,
    Stochastic,
    SupportsGripper,
    SupportsObstacleDistances,
)
from kinfeas.core.checks.adapter import CheckedAdapter, unchecked
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.robots.loading import load_robot

BASE, TWIST, JOINTS = np.tile(IDENTITY, (2, 1)), np.zeros((2, 6)), np.zeros((2, 7))
ROWS = np.array([0])


class OwnError(Exception):
    """What a plugin's author may think up."""


class Around:
    """A backend around a backend, of no class of ours, of the answers that a test gives it."""

    def __init__(self, backend, robot=None, answers=None):
        self.backend, self.answers, self.closed = backend, answers or {}, 0

    def answer(self, name, sound):
        given = self.answers.get(name, lambda sound: sound)
        if isinstance(given, BaseException):
            raise given
        return given(sound)

    def reset(self, base_pose, joint_positions, env_ids=None):
        return self.answer("reset", self.backend.reset(base_pose, joint_positions, env_ids))

    def step(self, base_twist, joint_targets, dt):
        command = self.answer("command", (base_twist, joint_targets))
        return self.answer("step", self.backend.step(*command, dt))

    def close(self):
        self.closed += 1
        self.answer("close", None)


class Able(Around):
    """The same, which can all there is."""

    def seed(self, seeds, env_ids):
        self.answer("seed", None)

    def grip(self, grip, env_ids):
        self.answer("grip", None)

    def obstacle_distances(self, within):
        return self.answer("obstacle_distances", within)

    def read(self):
        return self.answer("read", self.backend.state)

    def stop(self):
        self.answer("stop", None)

    def snapshot(self):
        return self.answer("snapshot", self.backend.snapshot())

    def restore(self, snapshot):
        return self.answer("restore", self.backend.restore(snapshot))


def checked(kind=Around, **answers):
    backend = AnalyticBackend()
    return CheckedAdapter(kind(backend, None, answers), "adapter 'mine'", backend)


def run(adapter):
    adapter.reset(BASE, JOINTS)
    adapter.reset(BASE[:1], JOINTS[:1], ROWS)
    return adapter.step(TWIST, JOINTS, 0.1)


def changed(**changes):
    return lambda state: replace(state, **changes)


BAD = {
    "no state": (lambda state: None, "must return a RobotState from {}, not NoneType"),
    "a pair": (lambda state: (BASE, JOINTS), "must return a RobotState from {}, not tuple"),
    "a flat base": (changed(base_pose=BASE[:, :3]), r"a base_pose of shape \(2, 7\) from {}, not"),
    "one row": (changed(base_pose=BASE[:1]), r"a base_pose of shape \(2, 7\) from {}, not \(1, 7"),
    "a list": (
        changed(base_pose=BASE.tolist()),
        r"a base_pose of shape \(2, 7\) from {}, not list",
    ),
    "lost joints": (changed(joint_positions=TWIST), r"joint_positions of shape \(2, 7\) from {}"),
    "words": (changed(joint_positions=JOINTS.astype(str)), "from {}, not an array of <U32"),
    "objects": (changed(base_pose=BASE.astype(object)), "from {}, not an array of object"),
    "nan": (changed(base_pose=BASE * np.nan), "returns a base_pose from {} with numbers that are"),
    "a flat EE": (changed(ee_in_base=BASE[:, :2]), r"an ee_in_base of shape \(2, 7\) from {}"),
    "no truth": (
        changed(true_state=BASE),
        "must return a RobotState as true_state from {}, not ndarray",
    ),
    "truth of nan": (
        changed(true_state=RobotState(BASE, JOINTS * np.nan)),
        "joint_positions as true_state f",
    ),
}


@pytest.mark.parametrize("method", ["reset", "step"])
@pytest.mark.parametrize("name", BAD)
def test_malformed_answers_are_refused(name, method):
    answer, sentence = BAD[name]
    with pytest.raises(KinfeasError, match=f"^adapter 'mine' .*{sentence.format(method)}"):
        run(checked(**{method: answer}))


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (
            (TWIST * np.nan, JOINTS),
            "returns a base_pose from step with numbers that are not finite",
        ),
        ((TWIST, JOINTS[:, :3]), r"must return joint_positions of shape \(2, 7\) from step, not"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_what_comes_of_a_malformed_command_is_refused(command, sentence):
    with pytest.raises(KinfeasError, match=f"^adapter 'mine' {sentence}"):
        run(checked(command=lambda _: command))


@pytest.mark.parametrize("method", ["reset", "step", "close", "seed", "grip", "stop", "snapshot"])
@pytest.mark.parametrize("error", [RuntimeError("no"), KeyError("x"), SystemExit(5), OwnError("o")])
def test_what_it_raises_names_it_and_the_line(method, error):
    adapter, arguments = checked(Able, **{method: error}), {"seed": 2, "grip": 2, "reset": 2}
    name = type(error).__name__
    sentence = rf"^adapter 'mine' fails in {method}: {name}: .* \(test_adapter.py, line \d+\)$"
    with pytest.raises(KinfeasError, match=sentence):
        if method == "step":
            run(adapter)
        else:
            getattr(adapter, method)(*[BASE, JOINTS][: arguments.get(method, 0)])


@pytest.mark.parametrize("error", [KinfeasError("the bus is gone"), MemoryError()])
def test_what_is_nobodys_mistake_stays_what_it_is(error):
    with pytest.raises(type(error)) as caught:
        run(checked(step=error))
    assert caught.value is error


@pytest.mark.parametrize(
    "protocol", [Stochastic, SupportsGripper, SupportsObstacleDistances, RealTimeBackend, Resumable]
)
def test_it_can_what_the_adapter_can(protocol):
    assert isinstance(checked(Able), protocol)
    assert not isinstance(checked(), protocol)


def test_sound_answers_come_through():
    adapter = checked(Able, step=changed(base_pose=BASE.astype(np.float32)))
    assert run(adapter).base_pose.dtype == np.float32
    adapter.close()
    assert adapter.adapter.closed == 1
    assert adapter.read() is adapter.backend.state


def test_a_copy_asks_the_adapter_of_its_own():
    first = checked(Able)
    run(first)
    for again in (copy.deepcopy(first), pickle.loads(pickle.dumps(first))):
        again.reset(BASE + IDENTITY, JOINTS)
        np.testing.assert_array_equal(again.snapshot()["base_pose"], BASE + IDENTITY)
        np.testing.assert_array_equal(first.snapshot()["base_pose"], BASE)


def test_goes_on_from_a_snapshot_of_any_number_of_robots():
    first, other = checked(Able), checked(Able)
    run(first)
    assert other.restore(first.snapshot()).base_pose.shape == (2, 7)
    assert other.step(TWIST, JOINTS, 0.1).base_pose.shape == (2, 7)
    bad = checked(Able, restore=changed(base_pose=BASE.tolist()))
    with pytest.raises(
        KinfeasError, match=r"must return a base_pose of shape \(2, 7\) from restore"
    ):
        bad.restore(first.snapshot())


def test_only_what_comes_from_outside_is_looked_at(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.adapters", "around", Around)
    robot, world = load_robot("pr2"), AnalyticBackend()
    adapter = wrap(world, [PluginSpec("around")], robot)
    assert isinstance(adapter, CheckedAdapter)
    assert isinstance(unchecked(adapter), Around)
    assert unchecked(world) is world
    own = wrap(world, [PluginSpec("base_noise")], robot)
    assert unchecked(own) is own
