import math
from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core import registry
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.sim2real.adapters.adapter import Adapter

BASE, TWIST = np.tile(IDENTITY, (2, 1)), np.zeros((2, 6))


class Answering(Adapter):
    """An adapter of the answers that a test gives it."""

    answers: dict = {}  # noqa: RUF012 - a test sets it

    def answer(self, name, sound):
        given = self.answers.get(name, lambda sound: sound)
        if isinstance(given, BaseException):
            raise given
        return given(sound)

    def on_reset(self, state):
        return self.answer("on_reset", {"since": np.zeros(len(state.base_pose))})

    def modify_command(self, twist, targets, dt):
        return self.answer("modify_command", (twist, targets))

    def on_step(self, state, dt):
        self.answer("on_step", None)

    def modify_state(self, state):
        return self.answer("modify_state", state)


class OwnError(Exception):
    """What a plugin's author may think up."""


class Orphan(Adapter):
    def __init__(self, backend, robot):
        self.backend = backend


def nothing(backend, robot):
    """Return no adapter."""


@pytest.fixture
def run(pr2, monkeypatch):
    """Return a function that resets and steps an adapter of given answers."""
    monkeypatch.setattr(registry, "_REGISTERED", [])
    for name, factory in (("mine", Answering), ("orphan", Orphan), ("nothing", nothing)):
        registry.register("kinfeas.adapters", name, factory)

    def carry(backend=None, name="mine", **answers):
        monkeypatch.setattr(Answering, "answers", answers)
        joints = np.tile(pr2.home["home"], (2, 1))
        adapter = wrap(backend or AnalyticBackend(), [PluginSpec(name)], pr2)
        adapter.reset(BASE, joints)
        return adapter.step(TWIST, joints, 0.1)

    return carry


def changed(**changes):
    return lambda state: replace(state, **changes)


BAD = {
    "a list": (
        "on_reset",
        lambda memory: [1],
        "must return a dict of arrays of leading axis 2 from",
    ),
    "one row": ("on_reset", lambda memory: {"a": np.zeros(1)}, "of leading axis 2 from on_reset"),
    "no pair": ("modify_command", lambda both: both[0], "must return a pair from modify_command"),
    "nothing": ("modify_command", lambda both: None, "must return a pair from modify_command"),
    "flat": (
        "modify_command",
        lambda both: (both[0][:, :3], both[1]),
        r"must return a twist of shape \(2, 6\) from modify_command, not \(2, 3\)",
    ),
    "nan": (
        "modify_command",
        lambda both: (both[0] * np.nan, both[1]),
        "returns a twist from modify_command with numbers that are not finite",
    ),
    "short floats": (
        "modify_command",
        lambda both: (both[0].astype(np.float32) + np.inf, both[1]),
        "returns a twist from modify_command with numbers that are not finite",
    ),
    "words": (
        "modify_command",
        lambda both: (both[0].astype(str), both[1]),
        "a twist of .*, not an array of <U",
    ),
    "lists": (
        "modify_command",
        lambda both: (both[0], both[1].tolist()),
        "joint targets of .*, not list",
    ),
    "no state": (
        "modify_state",
        lambda state: None,
        "must return a RobotState from modify_state, not NoneType",
    ),
    "a flat base": (
        "modify_state",
        changed(base_pose=BASE[:, :3]),
        r"a base_pose of shape \(2, 7\) from",
    ),
    "lost joints": (
        "modify_state",
        changed(joint_positions=TWIST),
        r"joint_positions of shape \(2, 7\)",
    ),
    "a base of nan": (
        "modify_state",
        changed(base_pose=BASE * np.nan),
        "a base_pose from modify_state with",
    ),
    "no truth": (
        "modify_state",
        changed(true_state="yes"),
        "must return a RobotState as true_state from modify_state, not st",
    ),
    "a truth of nan": (
        "modify_state",
        changed(true_state=RobotState(BASE * np.nan, np.zeros((2, 7)))),
        "returns a base_pose as true_state from modify_state with numbers",
    ),
    "no EE": (
        "modify_state",
        changed(ee_in_base=BASE + np.inf),
        "an ee_in_base from modify_state with numbers",
    ),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_malformed_answers_are_refused(run, name):
    hook, answer, sentence = BAD[name]
    with pytest.raises(KinfeasError, match=f"^adapter 'mine' .*{sentence}"):
        run(**{hook: answer})


@pytest.mark.parametrize("hook", ["on_reset", "modify_command", "on_step", "modify_state"])
@pytest.mark.parametrize("error", [RuntimeError("b"), KeyError("x"), SystemExit(5), OwnError("o")])
def test_what_a_hook_raises_names_the_adapter(run, hook, error):
    name = type(error).__name__
    with pytest.raises(KinfeasError, match=rf"^adapter 'mine' fails in {hook}: {name}: .*line \d"):
        run(**{hook: error})


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("orphan", "^adapter 'orphan' must call the constructor of Adapter"),
        ("nothing", "must return an object with the methods reset, step, close, not NoneType$"),
    ],
)
def test_adapters_that_are_none(run, name, sentence):
    with pytest.raises(KinfeasError, match=sentence):
        run(name=name)


def test_the_machines_trouble_stays_what_it_is(run):
    with pytest.raises(MemoryError):
        run(modify_command=MemoryError())


def test_sound_answers_come_through(run):
    huge = np.full((2, 6), 1e200)
    state = run(modify_command=lambda both: (both[0].astype(np.float32), both[1]))
    assert np.array_equal(state.base_pose, BASE)
    assert run(modify_command=lambda both: (huge * 0.0, both[1])) is not None
    seen = run(modify_state=changed(base_pose=BASE + 0.0, joint_velocities=huge))
    assert seen.joint_velocities is huge


def test_what_is_measured_wrong_is_not_the_adapters_fault(run):
    class Lost(AnalyticBackend):
        def step(self, base_twist, joint_targets, dt):
            return RobotState(np.full((2, 7), math.nan), joint_targets)

    seen = run(Lost(), modify_state=lambda state: replace(state))
    assert np.isnan(seen.base_pose).all()


def test_what_the_backend_raises_stays_what_it_is(run):
    class Gone(AnalyticBackend):
        def step(self, base_twist, joint_targets, dt):
            raise ConnectionError("the bus is gone")

    with pytest.raises(ConnectionError):
        run(Gone())


def test_our_own_adapters_are_not_looked_at(pr2):
    own = wrap(AnalyticBackend(), [PluginSpec("base_noise")], pr2)
    assert own._hooks is own
