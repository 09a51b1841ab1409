from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import MOST_SOLIDS
from kinfeas.core.spatial import rotation, wrap, yaw
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.kinematics.solids import collides
from kinfeas.tasks.loading import load_task, read_chain
from kinfeas.tasks.task import MotionSpec

FETCH = {
    "name": "name: fetch",
    "places": "places: {cup: {position: [1, 2, 3]}}",
    "subgoals": "subgoals: [{place: cup}]",
}


@pytest.fixture
def write(tmp_path):
    """A function that writes a task with some lines replaced and returns its path."""

    def make(*lines):
        path = tmp_path / "task.yaml"
        changed = FETCH | {line.split(":")[0]: line for line in lines}
        path.write_text("\n".join(changed.values()))
        return path

    return make


FIXED = {"object": "pick_table", "link": "table"}


def approach(targets):
    """Return the approach axes of the gripper in the world, (n, 3)."""
    return rotation(targets).as_matrix()[:, :, 0]


def test_starts(hsr, sample, uniform):
    task = load_task("pick_place")
    starts = sample(task)
    assert starts.target_poses.shape == (300, len(task.subgoals), 7)
    x, y = starts.base_pose[:, 0], starts.base_pose[:, 1]
    assert uniform(x, -0.75, 0.75)
    assert uniform(y, -0.75, 0.75)
    way = starts.target_poses[:, 0, :2] - starts.base_pose[:, :2]
    turn = wrap(yaw(starts.base_pose) - np.arctan2(way[:, 1], way[:, 0]))
    assert uniform(turn, -np.pi / 2, np.pi / 2)
    assert not self_collides(hsr.collision, starts.joint_positions).any()
    assert forward(hsr.chain, starts.joint_positions)[:, 2].std() > 0.1


def test_parameters_change_their_own_entries_only():
    plain = load_task("pick_place")
    task = load_task("pick_place", {"places": {"table": {"rpy": [0, 0, 3]}}})
    table = replace(plain.places["table"], rpy=(0.0, 0.0, 3.0))
    assert task == replace(plain, places={**plain.places, "table": table})
    grasp, pull = load_task("door").subgoals
    motion = {"generator": "minimum_jerk", "parameters": {"max_velocity": 0.05}}
    changed = load_task("door", {"subgoals": {"0": {"motion": motion}}}).subgoals
    assert changed == (replace(grasp, motion=MotionSpec(**motion)), pull)
    changes = {"1": {"dwell": 3.0, "motion": {"parameters": {"gain": 0.5}}}}
    slower = load_task("door", {"subgoals": changes}).subgoals
    parameters = {"model": "door_open", "gain": 0.5}
    assert slower == (grasp, replace(pull, dwell=3.0, motion=MotionSpec("imitation", parameters)))
    other = load_task("door", {"subgoals": {"0": {"motion": {"generator": "linear"}}}})
    assert other.subgoals[0].motion == MotionSpec("linear")


def test_files_are_found_beside_the_task_from_any_folder(write, tmp_path, monkeypatch):
    motion = "motion: {generator: waypoints, parameters: {file: way.yaml}}"
    scene = "scene: {name: kitchen.yaml, success: {object: chest, joint: slide, threshold: 0.1}}"
    path = write(f"subgoals: [{{place: cup, {motion}}}]", scene)
    (tmp_path / "way.yaml").touch()
    (tmp_path / "elsewhere").mkdir()
    for name in ("kitchen.yaml", "other.yaml"):
        text = "objects: {chest: {urdf: shelf_with_drawer.urdf, position: [2, 0, 0]}}"
        (tmp_path / "elsewhere" / name).write_text(f"name: kitchen\nsize: [9, 9]\n{text}")
    monkeypatch.chdir(tmp_path / "elsewhere")
    task = read_chain(path)
    assert task.subgoals[0].motion.parameters == {"file": str(tmp_path / "way.yaml")}
    assert task.scene.name == "kitchen.yaml"  # not there: searched in the current folder
    assert read_chain(path, {"scene": {"name": "other.yaml"}}).scene.name == "other.yaml"


@pytest.mark.parametrize(("line", "key"), [
    ("subgoals: [{place: cap}]", r"subgoals\.0\.place.*'cup'"),
    ("subgoals: [{place: cup, offset: [0, 0, 1e300]}]", r"subgoals\.0\.offset\.2"),
    ("places: {cup: {position: [1, 2, [4, 3]]}}", "position"),
    ("places: {cup: {position: [1, 2, 3]}, cp: {position: [1, 2, 3]}}", r"places\.cp"),
    ("scene: {name: room, success: {object: box}}", "parent"),
    ("subgoals: [{place: cup, motion: {generator: 'os:system'}}]", "os:system"),
    ("scene: {name: rom, success: {object: box, parent: door_base}}", "rom.*'room'"),
    (
        "scene: {name: room, success: {object: box, parent: walls}, moves: {box: {place: tea}}}",
        r"scene\.moves\.box\.place",
    ),
])  # fmt: skip
def test_wrong_files_raise(write, line, key):
    path = write(line)
    with pytest.raises(KinfeasError, match=f"^{path}: .*{key}"):
        read_chain(path)


def test_objects_are_at_their_places(hsr):
    task = load_task("pick_place")
    for i in range(20):
        targets = task.sample(hsr, np.random.default_rng((1, i))).target_poses
        poses = task.object_poses(targets)
        assert poses.keys() == {"box", "place_table"}
        # The gripper's tip comes to rest within the box, and above the table.
        np.testing.assert_allclose(poses["box"][1:3], targets[1, 1:3] + [0.0, 0.025], atol=1e-9)
        assert 0.0 < poses["box"][0] - targets[1, 0] < 0.075
        way = targets[3, :3] - poses["place_table"][:3]
        np.testing.assert_allclose(way[:2], [0.0, 0.275], atol=1e-9)
        assert poses["place_table"][2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "places"),
    [("pick_place_cluttered", 8), ("door_cluttered", 8), ("shelf", 0), ("room_door", 0)],
)
def test_episodes_in_clutter_start_free_with_furniture_and_solids(hsr, name, places):
    task = load_task(name)
    for seed in range(5):
        start = task.sample(hsr, np.random.default_rng(seed))
        furniture, solids = task.furniture(start.target_poses), start.solids
        np.testing.assert_array_equal(solids.size[:, : furniture.places], furniture.size)
        assert solids.places == furniture.places + places
        rows = start.joint_positions[np.newaxis], start.base_pose[np.newaxis], solids
        assert not collides(hsr.collision, *rows).any()
        clutter = solids.beyond(furniture.places)
        floor = start.target_poses * [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        if places:
            assert clutter.filled.any()
            assert clutter.gaps(floor[np.newaxis, :, :3])[0].min() >= 0.7
            assert furniture.gaps(clutter.centre[..., :3] * [1.0, 1.0, 0.0])[0].min() > 0.1
    if places:
        full = replace(task, clutter=MOST_SOLIDS).sample(hsr, np.random.default_rng(4))
        assert full.solids.places == MOST_SOLIDS
    again = task.sample(hsr, np.random.default_rng(4))
    np.testing.assert_array_equal(again.solids.pose, start.solids.pose)


def test_a_file_extends_another(write, tmp_path):
    base = read_chain(write())
    (tmp_path / "more.yaml").write_text("extends: task.yaml\nname: more\nstart: {square: 0.5}\n")
    more = read_chain(tmp_path / "more.yaml")
    assert more == replace(base, name="more", start=replace(base.start, square=0.5))


@pytest.mark.parametrize(("name", "changes", "key"), [
    ("door", {"success": {"joint": "x"}}, "success.joint"),
    ("door", {"grasped_object": {"link": "x"}}, "grasped_object.link"),
    ("pick_place", {"success": {"parent": "tabel"}}, "success.parent"),
    ("pick_place", {"moves": {"bax": {"place": "table"}}}, "moves.bax"),
    ("pick_place", {"grasped_object": FIXED}, "grasped_object"),
])  # fmt: skip
def test_a_task_needs_the_objects_of_its_scene(name, changes, key):
    with pytest.raises(KinfeasError, match=f"'scene.{key}'"):
        load_task(name, {"scene": changes})


def test_a_handle_of_the_scene_is_a_place(write, sample):
    scene = "scene: {name: room, success: {object: door_shelf, joint: hinge, threshold: 1}}"
    task = read_chain(write("places: {}", "subgoals: [{place: door, frame: tip}]", scene))
    np.testing.assert_allclose(
        sample(task, 2).target_poses[:, 0], sample(load_task("door"), 2).target_poses[:, 0]
    )
    with pytest.raises(KinfeasError, match=r"subgoals\.0\.place.*'doro'.*door.*drawer"):
        read_chain(write("places: {}", "subgoals: [{place: doro}]", scene))
    with pytest.raises(KinfeasError, match=r"places\.unused.*known are door"):
        places = "places: {unused: {position: [1, 0, 1]}}"
        read_chain(write(places, "subgoals: [{place: door}]", scene))


@pytest.mark.parametrize(("place", "grasped", "named"), [
    ("door", "grasped_object: {object: door_shelf, link: handle}", None),
    ("drawer", "grasped_object: {object: door_shelf, link: handle}", "drawer_shelf"),
    ("cup", "grasped_object: {object: door_shelf, link: handle}", "box"),
    ("cup", "grasped_object: {object: box, link: box}", None),
    ("door", "moves: {}", "nothing"),
])  # fmt: skip
def test_grippers_close_at_the_grasped_object(write, place, grasped, named):
    moves = "" if "moves" in grasped else ", moves: {box: {place: cup}}"
    lines = (
        "places: {cup: {position: [1, 0, 1]}}",
        f"scene: {{name: room, {grasped}{moves}}}",
        f"subgoals: [{{place: cup}}, {{place: {place}, grip: close}}]",
    )
    if named is None:
        read_chain(write(*lines))
    else:
        with pytest.raises(KinfeasError, match=rf"subgoals\.1\.grip.*{named}"):
            read_chain(write(*lines))
