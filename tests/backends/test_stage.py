from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.physics.stage import Stage
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from kinfeas.tasks.chain import ChainSubgoal, ChainTask, Place, SuccessCondition, TaskScene
from kinfeas.tasks.loading import load_task
from tests.backends.conftest import place, stay


@pytest.fixture(scope="module")
def solver():
    return IkSolver(load_robot("tiago"))


@pytest.fixture(scope="module")
def room_stage(hsr, engine):
    """A task without objects in a room with furniture."""
    backend = engine(hsr, read_scene("room"))
    yield Stage(load_task("ggr"), backend)
    backend.close()


@pytest.fixture(scope="module", params=["pick_place", "door", "drawer"])
def stage(request, solver, engine):
    made = engine(solver.robot).stage(load_task(request.param))
    yield made
    made.backend.close()


def begin(stage, solver, seed):
    start = stage.sample(solver, np.random.default_rng(seed))
    stage.backend.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])
    return start


def test_episodes_start_free_of_collisions_and_not_done(stage, solver):
    assert (stage.name, stage.subgoals) == (stage.task.name, stage.task.subgoals)
    for seed in range(5):
        start = begin(stage, solver, seed)
        scene, poses, beside = stage.drawn(start)
        assert (scene, beside) == ("room", None)
        assert poses.keys() == stage.task.scene.moves.keys()
        assert not stage.backend.touched()
        assert stage.done() is False
        for name, pose in poses.items():
            measured, _ = stage.backend.object_motion(0, name)
            assert spatial.distance(measured, pose)[0] <= 1e-6


def test_a_start_in_collision_is_drawn_again_with_the_same_goals(stage, solver, monkeypatch):
    allowed = stage.task.start
    for seed in range(20):
        first = stage.task.sample(solver, np.random.default_rng(seed))
        answers, rng = iter([False, True]), np.random.default_rng(seed)
        monkeypatch.setattr(stage.backend, "place", lambda *_, answers=answers: next(answers))
        start = stage.sample(solver, rng)
        np.testing.assert_array_equal(start.target_poses, first.target_poses)
        assert not np.array_equal(start.base_pose, first.base_pose)
        x, y = start.base_pose[:2]
        assert max(abs(x), abs(y)) <= allowed.square / 2.0
        ahead = start.target_poses[0, :2] - [x, y]
        turned = float(spatial.yaw(start.base_pose)) - np.arctan2(ahead[1], ahead[0])
        assert abs((turned + np.pi) % (2.0 * np.pi) - np.pi) <= allowed.heading + 1e-9


def arrange(stage, solver, scene):
    start = stage.sample(solver, np.random.default_rng(5))
    stage.backend.place(0, scene, start.base_pose, start.joint_positions)
    stage.backend.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])
    stay(stage.backend, 50)


def test_the_success_condition_is_measured(stage, solver, monkeypatch):
    success, scene = stage.task.scene.success, stage.scene
    if success.joint is None:
        on_top = np.array([0.0, 0.0, 0.64, 0.0, 0.0, 0.0, 1.0])
        pose = spatial.compose(scene.objects["place_table"].pose, on_top)
        arrange(stage, solver, scene.with_poses({success.object: pose}))
    else:
        opened = {success.object: {success.joint: 1.1 * success.threshold}}
        arrange(stage, solver, scene.with_joints(opened))
    assert stage.done() is True
    if success.joint is None:  # an object in the hand was not put down
        monkeypatch.setattr(stage.backend, "holds", lambda *_: True)
        assert stage.done() is False


@pytest.mark.parametrize(("threshold", "opened"), [(-0.15, -0.2), (0.15, 0.2)])
def test_a_joint_opens_in_the_direction_of_its_threshold(
    hsr, scene_path, threshold, opened, engine
):
    success = SuccessCondition("chest", joint="slide", threshold=threshold)
    here = {"here": Place((1.0, 0.0, 0.8))}
    subgoals = (ChainSubgoal(place="here"),)
    task = ChainTask("pull", subgoals, here, scene=TaskScene(scene_path, success))
    stage, solver = engine(hsr).stage(task), IkSolver(hsr)
    for position, done in ((0.0, False), (-opened, False), (opened, True)):
        arrange(stage, solver, stage.scene.with_joints({"chest": {"slide": position}}))
        assert stage.done() is done
    stage.backend.close()


# The place table is 0.52 m high at (0.25, -2.75), one of its legs ends at x = 0.58, y = -2.42.
@pytest.mark.parametrize(("position", "quaternion", "stands"), [
    ((0.25, -2.75, 0.636), (0.0, 0.0, 0.0, 1.0), True),
    ((0.25, -2.75, 0.636), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), True),
    ((0.25, -2.75, 0.60), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), False),  # on its side
    ((0.6295, -2.42, 0.115), (0.0, 0.0, 0.0, 1.0), False),  # on the floor, touching a leg
    ((-0.5, -2.0, 0.115), (0.0, 0.0, 0.0, 1.0), False),  # on the floor
])  # fmt: skip
def test_an_object_stands_if_upright_at_rest_on_another(
    room_stage, monkeypatch, position, quaternion, stands
):
    world = room_stage.backend
    place(world, scene=world.scene.with_poses({"box": np.array([*position, *quaternion])}))
    stay(world, 100)
    assert room_stage.stands(0, "box", "place_table") is stands
    pose, _ = world.object_motion(0, "box")
    monkeypatch.setattr(world, "object_motion", lambda *_: (pose, 0.2))
    assert not room_stage.stands(0, "box", "place_table")


def test_grasping_needs_a_gripper(hsr, engine):
    bare, door = replace(hsr, gripper=None), load_task("door")
    with pytest.raises(KinfeasError, match="gripper"):
        engine(bare).stage(door)
    engine(bare).stage(replace(door, scene=replace(door.scene, grasped_object=None)))


@pytest.mark.parametrize(
    ("name", "bodies"), [("pick_place_cluttered", 8), ("shelf", 0), ("door", 0)]
)
def test_furniture_is_known_and_simulated_once(name, bodies, solver, engine):
    stage = engine(solver.robot).stage(load_task(name))
    backend = stage.backend
    for seed in range(3):
        start = begin(stage, solver, seed)
        backend.place_solids(start.solids, np.array([0]))
        simulated = backend.solid_bodies()
        assert (simulated.places if simulated else 0) == bodies
        assert backend.solids.after().places == start.solids.places >= 15
        assert not backend.touched()
        assert stage.done() is False
    backend.close()
    bare = engine(solver.robot, objects=False).stage(load_task(name)).backend
    bare.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])
    bare.place_solids(start.solids, np.array([0]))
    assert bare.solid_bodies().places == start.solids.places
    bare.close()


def test_success_may_include_the_goal(solver, engine, monkeypatch):
    stage = engine(solver.robot).stage(load_task("room_door"))
    arrange(stage, solver, stage.scene.with_joints({"door": {"hinge": 1.2}}))
    assert stage.done() is True
    joints = np.array([solver.robot.home["home"]])
    assert stage.task_done(0, joints, 0.02, reached=False) is False
    assert stage.task_done(0, joints, 0.02, reached=True) is True
    stage.backend.close()
