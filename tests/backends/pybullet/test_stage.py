import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.collision import SceneCollision, robot_touches
from kinfeas.tasks.chain import ChainSubgoal, ChainTask, Place, SuccessCondition, TaskScene
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.stage import Stage, task_scene


def build(name):
    task = load_task(name)
    backend = PyBulletBackend(load_robot("tiago"), task_scene(task))
    return Stage(task, backend)


@pytest.fixture(scope="module")
def solver():
    return IkSolver(load_robot("tiago"))


@pytest.fixture(scope="module", params=["pick_place", "door", "drawer"])
def stage(request):
    made = build(request.param)
    yield made
    made.backend.close()


def begin(stage, solver, seed):
    start = stage.sample(solver, np.random.default_rng(seed))
    stage.backend.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])
    return start


def test_takes_the_place_of_its_task(stage):
    assert stage.name == stage.task.name
    assert stage.subgoals == stage.task.subgoals


def test_episodes_begin_free_of_collisions_with_nothing_done(stage, solver):
    for seed in range(5):
        start = begin(stage, solver, seed)
        there = SceneCollision(stage.backend.sims[0].furniture.scene)
        assert not robot_touches(there, solver.robot, start.base_pose, start.joint_positions)
        assert stage.backend.sims[0].free()
        assert stage.done() is False


def test_a_start_in_the_way_moves_the_robot_and_not_the_furniture(stage, solver, monkeypatch):
    first = stage.task.sample(solver, np.random.default_rng(7))
    answers = iter([False, False, True])
    monkeypatch.setattr(stage.backend.sims[0], "free", lambda: next(answers))
    start = stage.sample(solver, np.random.default_rng(7))
    np.testing.assert_array_equal(start.target_poses, first.target_poses)
    assert not np.array_equal(start.base_pose, first.base_pose)
    assert not np.array_equal(start.joint_positions, first.joint_positions)


def test_a_start_in_the_way_is_drawn_anew_as_the_task_allows(stage, solver, monkeypatch):
    allowed = stage.task.start
    rng = np.random.default_rng(0)
    monkeypatch.setattr(stage.backend.sims[0], "reset", lambda *_: None)
    for _ in range(300):
        answers = iter([False, True])
        monkeypatch.setattr(stage.backend.sims[0], "free", lambda answers=answers: next(answers))
        start = stage.sample(solver, rng)
        x, y = start.base_pose[:2]
        assert max(abs(x), abs(y)) <= allowed.square / 2.0
        heading = 2.0 * np.arctan2(start.base_pose[5], start.base_pose[6])
        ahead = start.target_poses[0, :2] - [x, y]
        turned = heading - np.arctan2(ahead[1], ahead[0])
        assert abs((turned + np.pi) % (2.0 * np.pi) - np.pi) <= allowed.heading + 1e-9


def test_equal_seeds_draw_equal_episodes(stage, solver):
    one, other = (stage.sample(solver, np.random.default_rng(3)) for _ in range(2))
    for key, value in vars(one).items():
        np.testing.assert_array_equal(value, vars(other)[key])


def test_moves_what_the_episode_moves(stage, solver):
    start = begin(stage, solver, 4)
    for name, pose in stage.task.object_poses(start.target_poses).items():
        link = stage.scene.objects[name].urdf.root
        measured = stage.backend.sims[0].furniture.link_pose(name, link)
        assert spatial.distance(measured, pose)[0] <= 1e-6


def test_the_task_is_done_when_the_world_says_so(stage, solver):
    begin(stage, solver, 5)
    done, backend = stage.task.scene.success, stage.backend
    if done.joint is None:
        table = backend.sims[0].furniture.link_pose("place_table", "table")
        on_top = spatial.compose(table, np.array([0.0, 0.0, 0.64, 0.0, 0.0, 0.0, 1.0]))
        backend.sims[0].physics.place(backend.sims[0].furniture.bodies["box"], on_top)
    else:
        number = backend.sims[0].physics.joints(backend.sims[0].furniture.bodies[done.object])[
            done.joint
        ]
        backend.sims[0].physics.client.resetJointState(
            backend.sims[0].furniture.bodies[done.object], number, 1.1 * done.threshold
        )
    home = backend.sims[0].body.state().joint_positions
    for _ in range(50):
        backend.step(np.zeros((1, 6)), home, 0.02)
    assert stage.done() is True


def test_what_the_hand_holds_is_not_put_down(stage, solver, monkeypatch):
    begin(stage, solver, 5)
    done, backend = stage.task.scene.success, stage.backend
    if done.joint is not None:
        pytest.skip("a door may be held open")
    monkeypatch.setattr(backend.sims[0].furniture, "stands", lambda *_: True)
    assert stage.done() is True
    backend.sims[0].grasp.held = backend.sims[0].furniture.link("box", "box")
    try:
        assert stage.done() is False
    finally:
        backend.sims[0].grasp.release()


def test_a_hand_in_the_air_holds_nothing(stage, solver):
    begin(stage, solver, 6)
    stage.backend.grip("close", np.array([0]))
    home = stage.backend.sims[0].body.state().joint_positions
    for _ in range(10):
        stage.backend.step(np.zeros((1, 6)), home, 0.02)
    assert stage.backend.sims[0].grasp.held is None


def test_the_arm_does_not_begin_within_the_floor(solver):
    stage = Stage(load_task("ggr"), PyBulletBackend(solver.robot))
    for seed in range(20):
        start = begin(stage, solver, seed)
        before = stage.backend.sims[0].body.state().joint_positions
        for _ in range(10):
            after = stage.backend.step(np.zeros((1, 6)), start.joint_positions[np.newaxis], 0.02)
        np.testing.assert_allclose(after.joint_positions, before, atol=5e-3)
    stage.backend.close()


def test_without_a_scene_there_is_nothing_to_do(solver):
    assert task_scene(load_task("ggr")) is None
    backend = PyBulletBackend(solver.robot)
    stage = Stage(load_task("door"), backend)
    begin(stage, solver, 0)
    assert stage.done() is None
    with pytest.raises(KinfeasError, match="grasping needs a scene"):
        backend.handle("box", "box")
    backend.close()


def test_objects_drawn_into_each_other_are_one_sentence(solver):
    sunk = {"scene": {"moves": {"box": {"offset": [0.04, 0.0, -0.1]}}}}
    task = load_task("pick_place", sunk)
    backend = PyBulletBackend(solver.robot, task_scene(task))
    message = "^task 'pick_place': objects 'pick_table' and 'box' stand within each other"
    with pytest.raises(KinfeasError, match=message):
        Stage(task, backend).sample(solver, np.random.default_rng(0))
    backend.close()


def test_shipped_episodes_can_be(stage, solver):
    moves = stage.task.object_poses
    for seed in range(100):
        start = stage.task.sample(solver, np.random.default_rng((1, seed)))
        stage.scene.with_poses(moves(start.target_poses)).check_places("shipped")


@pytest.mark.parametrize(("threshold", "open_at"), [(-0.15, -0.2), (0.15, 0.2)])
def test_a_joint_may_open_to_either_side(solver, scene, threshold, open_at, tmp_path):
    chest = scene.objects["chest"].urdf_path.read_text()
    (tmp_path / "chest.urdf").write_text(chest.replace('lower="0"', 'lower="-0.4"'))
    place = "{urdf: chest.urdf, position: [0, -4, 0.5]}"
    path = tmp_path / "chest.yaml"
    path.write_text(f"name: chest\nsize: [10, 10]\nobjects:\n  chest: {place}\n")
    wanted = TaskScene(str(path), SuccessCondition("chest", joint="slide", threshold=threshold))
    place = {"here": Place((1.0, 0.0, 0.8))}
    task = ChainTask("pull", (ChainSubgoal(place="here"),), place, scene=wanted)
    stage = Stage(task, PyBulletBackend(solver.robot, task_scene(task)))
    furniture, client = (
        stage.backend.sims[0].furniture,
        stage.backend.sims[0].physics.client,
    )
    begin(stage, solver, 0)
    number = stage.backend.sims[0].physics.joints(furniture.bodies["chest"])["slide"]
    for position, done in ((0.0, False), (-open_at, False), (open_at, True)):
        client.resetJointState(furniture.bodies["chest"], number, position)
        assert stage.done() is done
    stage.backend.close()
