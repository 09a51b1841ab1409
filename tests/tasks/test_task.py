from dataclasses import dataclass, replace
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import MOST_SOLIDS, Solids
from kinfeas.core.spatial import IDENTITY
from kinfeas.core.start import Start
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.ggr import GoalReaching
from kinfeas.tasks.loading import load_task, task_name
from kinfeas.tasks.task import MotionSpec, Subgoal, build_subgoals, sample_start

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("motion", "named"), [
    (MotionSpec("liner"), "'liner'"),
    (MotionSpec("linear", {"gian": 1.0}), "'gian'"),
    (MotionSpec("replay"), "'file'"),
])  # fmt: skip
def test_wrong_motions_raise(motion, named):
    with pytest.raises(KinfeasError, match=named):
        build_subgoals([Subgoal(motion)])
    with pytest.raises(KinfeasError, match=rf"'subgoals\.1\.motion'.*{named}"):
        build_subgoals([Subgoal(), Subgoal(motion)])


@pytest.mark.parametrize(("task", "wrong", "named"), [
    ("ggr", {"distance": [2, 1]}, "distance"), ("ggr_obstacles", {"heights": [2, 1]}, "heights"),
    ("joystick", {"rate": [2, 1]}, "rate"), ("ggr_obstacles", {"spacing": 0.1}, "places"),
])  # fmt: skip
def test_parameters_out_of_range_raise(task, wrong, named):
    with pytest.raises(KinfeasError, match=f"'{named}' must"):
        load_task(task, wrong)


@dataclass(frozen=True)
class Given:
    start: object = None
    name: str = "given"
    subgoals: tuple = (Subgoal(),)

    def sample(self, solver, rng):
        if isinstance(self.start, BaseException):
            raise self.start
        return self.start


class Plain(Given):
    subgoals = ({"motion": "linear"},)

    def __init__(self):
        """Keep the sub-goals of the class."""


class StagedGiven(Given):
    drawn = task_done = Mock()

    def sample_in(self, row, solver, rng):
        return replace(self.start, joint_positions=self.start.joint_positions + 0.01 * row)


@pytest.fixture
def sound(hsr):
    return Start(IDENTITY, hsr.robot.home["home"], IDENTITY[np.newaxis])


LONG = np.array([0, 0, 0, 0, 0, 0, 1.01])


@pytest.mark.parametrize(("key", "value"), [
    ("base_pose", IDENTITY.astype(str)), ("base_pose", LONG), ("joint_positions", np.zeros(2)),
    ("joint_positions", np.full(5, np.inf)), ("joint_positions", np.full(5, 20.0)),
    ("target_poses", np.tile(IDENTITY, (3, 1))),
    ("target_poses", np.zeros((1, 7))), ("solids", Solids.empty(2)),
    ("solids", Solids.empty(1, MOST_SOLIDS + 1)),
    ("solids", replace(Solids.empty(1, 2), size=np.full((1, 2, 4), -1.0))),
])  # fmt: skip
def test_malformed_episodes_raise(hsr, sound, key, value):
    assert sample_start(Given(sound), hsr, RNG) is sound
    with pytest.raises(KinfeasError, match=f"'given'.*{key}"):
        sample_start(Given(replace(sound, **{key: value})), hsr, RNG)


def test_plugins_are_named_and_staged_tasks_know_their_row(hsr, sound):
    with pytest.raises(KinfeasError, match="base_pose"):
        sample_start(Given(None), hsr, RNG)
    with pytest.raises(KeyError) as caught:
        sample_start(Given(KeyError("x")), hsr, RNG)
    assert "'given'" in caught.value.__notes__[0]
    staged = sample_start(StagedGiven(sound), hsr, RNG, row=2)
    np.testing.assert_array_equal(staged.joint_positions, sound.joint_positions + 0.02)
    assert sample_start(StagedGiven(sound), hsr, RNG) is sound


def test_subgoals_of_plugins_have_their_type(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.tasks", "mine", Plain)
    with pytest.raises(KinfeasError, match="task 'mine': 'subgoals'"):
        load_task("mine")


def test_tasks_load_by_name_and_by_path(tmp_path):
    assert isinstance(load_task("ggr", {"start": "any"}), GoalReaching)
    path = tmp_path / "fetch.yaml"
    path.write_text("{name: f, places: {cup: {position: [2, 0, 1]}}, subgoals: [{place: cup}]}")
    changed = load_task(str(path), {"name": "turned"})
    assert isinstance(changed, ChainTask)
    assert changed.name == "turned"
    for unknown in ("fly", "./fly.yaml"):
        with pytest.raises(KinfeasError, match="fly"):
            load_task(unknown)
    names = ("ggr", "my.task", "my/fetch.yaml", "fetch.yml", "./fetch")
    assert [task_name(name) for name in names] == ["ggr", "my.task", "fetch", "fetch", "fetch"]
