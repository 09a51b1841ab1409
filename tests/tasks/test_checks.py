import copy
import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from kinfeas.backends.pybullet.stage import task_scene
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY
from kinfeas.core.start import Start
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.waypoints import draw_goals
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.chain import ChainTask, door
from kinfeas.tasks.checks import CheckedTask, unchecked
from kinfeas.tasks.ggr import GoalReaching
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import Subgoal

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def pr2():
    return IkSolver(load_robot("pr2"))


@dataclass(frozen=True)
class Given:
    """A task of the episode that it is made with."""

    start: object = None
    name: str = "given"
    subgoals: tuple = (Subgoal(),)
    radius: float = 2.0

    def sample(self, solver, rng):
        if isinstance(self.start, BaseException):
            raise self.start
        return self.start


class OwnDoor(ChainTask):
    """The door with what a plugin adds to it."""


def sound(solver):
    return Start(IDENTITY, solver.robot.home["home"], IDENTITY[np.newaxis])


LONG = np.array([0, 0, 0, 0, 0, 0, 1.01])
BAD = {
    "nothing": (lambda start: None, "base_pose"),
    "a flat base": (lambda start: replace(start, base_pose=IDENTITY[:3]), "base_pose"),
    "too few joints": (
        lambda start: replace(start, joint_positions=np.zeros(2)),
        "joint_positions",
    ),
    "no goals": (lambda start: replace(start, target_poses=np.empty((0, 7))), "target_poses"),
    "too many goals": (
        lambda start: replace(start, target_poses=np.tile(IDENTITY, (3, 1))),
        "target_poses",
    ),
    "words": (lambda start: replace(start, base_pose=IDENTITY.astype(str)), "base_pose"),
    "a goal of nan": (
        lambda start: replace(start, target_poses=np.full((1, 7), np.nan)),
        "target_poses is not finite",
    ),
    "endless joints": (
        lambda start: replace(start, joint_positions=np.full(7, np.inf)),
        "joint_positions is not finite",
    ),
    "zeros": (
        lambda start: replace(start, target_poses=np.zeros((1, 7))),
        "samples a target_poses whose quaternion is not of unit length",
    ),
    "a long base": (lambda start: replace(start, base_pose=LONG), "base_pose whose quaternion"),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_episodes_are_refused(pr2, name):
    change, sentence = BAD[name]
    task = Given(change(sound(pr2)))
    with pytest.raises(KinfeasError, match=rf"^task 'mine'.*{sentence}"):
        CheckedTask(task, "mine").sample(pr2, RNG)
    with pytest.raises(KinfeasError, match=rf"^task 'given'.*{sentence}"):
        World(pr2.robot, task, WorldConfig(), seed=0).start([0])


def test_malformed_goals_are_the_tasks_fault_in_a_ceiling_too(pr2):
    task = CheckedTask(Given(replace(sound(pr2), target_poses=np.zeros((1, 7)))), "mine")
    with pytest.raises(KinfeasError, match=r"^task 'mine' samples a target_poses whose"):
        draw_goals(pr2, task, 1, 0)


def test_its_exceptions_get_a_note(pr2):
    with pytest.raises(KeyError) as caught:
        CheckedTask(Given(KeyError("x")), "mine").sample(pr2, RNG)
    assert caught.value.__notes__ == ["raised by task 'mine'"]


@pytest.mark.parametrize(
    ("task", "sentence"),
    [
        (Given(subgoals=()), "must have a tuple of at least one sub-goal, not none"),
        (Given(subgoals=None), "must have a tuple of at least one sub-goal, not NoneType"),
        (
            Given(subgoals=(1,)),
            "must have sub-goals that are a Subgoal each, and a int has no 'motion'",
        ),
        (Given(name=""), "'name' must be printable, not empty"),
        (Given(name="a/b"), "'name' must be printable, not empty and without '/', not 'a/b'"),
        (Given(name=3), "'name' must be a string, not 3"),
    ],
)
def test_tasks_that_are_none(task, sentence):
    with pytest.raises(KinfeasError, match=f"^task 'mine':? {sentence}"):
        CheckedTask(task, "mine")


def test_all_else_comes_through(pr2):
    task = Given(sound(pr2))
    checked = CheckedTask(task, "mine")
    assert checked.sample(pr2, RNG) is task.start
    assert (checked.name, checked.subgoals, checked.radius) == ("given", task.subgoals, 2.0)
    assert not hasattr(checked, "scene")
    for again in (copy.deepcopy(checked), pickle.loads(pickle.dumps(checked))):
        assert (again.name, again.radius) == ("given", 2.0)
        np.testing.assert_array_equal(again.sample(pr2, RNG).base_pose, IDENTITY)


def test_a_chain_of_ones_own_keeps_its_furniture():
    chain = door()
    own = OwnDoor(chain.name, chain.subgoals, chain.places, chain.start, chain.scene)
    checked = CheckedTask(own, "mine")
    assert unchecked(checked) is own
    assert task_scene(checked).name == task_scene(chain).name


def nothing():
    """Return no task."""


def test_only_what_comes_from_outside_is_looked_at(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    registry.register("kinfeas.tasks", "given", Given)
    registry.register("kinfeas.tasks", "nothing", nothing)
    assert isinstance(load_task("given"), CheckedTask)
    assert isinstance(load_task("ggr"), GoalReaching)
    assert isinstance(load_task("door"), ChainTask)
    with pytest.raises(KinfeasError, match="must return an object with the methods sample, not No"):
        load_task("nothing")
    with pytest.raises(
        KinfeasError, match=r"^task 'given' must have a tuple of at least one sub-goal"
    ):
        load_task("given", {"subgoals": ()})
