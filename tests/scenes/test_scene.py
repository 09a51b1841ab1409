from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, make_pose, planar_pose, rotation
from kinfeas.scenes.scene import read_scene

HINGE = (0.185, 2.829)  # m, of the door


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.6755])
def test_an_opened_door_carries_its_handle_round_the_hinge(room, angle):
    closed = room.handle_pose("door")
    opened = room.with_joints({"door_shelf": {"hinge": angle}}).handle_pose("door")
    assert np.hypot(*(opened[:2] - HINGE)) == pytest.approx(np.hypot(*(closed[:2] - HINGE)))
    assert distance(opened, closed)[1] == pytest.approx(angle)
    assert opened[1] < closed[1]  # into the room
    assert opened[2] == pytest.approx(closed[2])


def test_a_drawer_comes_straight_out(room):
    opened = room.with_joints({"drawer_shelf": {"slide": 0.24}}).handle_pose("drawer")
    np.testing.assert_allclose(opened[:3] - room.handle_pose("drawer")[:3], [0.24, 0, 0], atol=1e-9)


def test_a_task_may_move_objects(room):
    pose = planar_pose(np.array(1.5), np.array(-2.9), np.array(0.3))
    moved = room.with_poses({"place_table": pose})
    np.testing.assert_array_equal(moved.objects["place_table"].pose, pose)
    assert moved.objects["pick_table"] is room.objects["pick_table"]
    np.testing.assert_allclose(room.objects["place_table"].pose[:2], [0.25, -2.75])
    moved.check_layout("moved")

    box = make_pose(np.array([2.725, 0.0, 0.5]), rotation(room.objects["box"].pose))
    with pytest.raises(KinfeasError, match=r"^moved: .*'pick_table' and 'box'"):
        room.with_poses({"box": box}).check_layout("moved")


@pytest.mark.parametrize(("change", "where"), [
    (lambda room: room.with_poses({"boxx": None}), "'boxx'.*'box'"),
    (lambda room: room.with_joints({"door_shelf": {"slide": 0.0}}), "'slide'"),
    (lambda room: room.with_joints({"door_shelf": {"hinge": 2.0}}), "hinge.*2"),
    (lambda room: room.handle_pose("dor"), "'dor'.*'door'"),
    (lambda _: read_scene("rom"), "'rom'.*'room'"),
])  # fmt: skip
def test_unknown_names_are_errors(room, change, where):
    with pytest.raises(KinfeasError, match=where):
        change(room)


def test_the_documented_scene_is_one(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    path = tmp_path / "kitchen.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0])
    assert list(read_scene(str(path)).objects) == ["table", "cupboard", "mug"]


def test_a_scene_with_other_furniture(write, tmp_path, room):
    own, bench = room.objects["pick_table"], tmp_path / "parts" / "bench.urdf"
    bench.parent.mkdir()
    bench.write_text(own.urdf_path.read_text())
    for name in ("parts/../parts/bench.urdf", str(bench)):
        table = read_scene(write("table.urdf", name)).objects["table"]
        assert table.urdf_path.samefile(bench)
        assert table.mass == own.mass


@pytest.mark.parametrize(("old", "new", "where"), [
    ("table.urdf", "tabel.urdf", "'objects.table.urdf'.*table.urdf"),
    ("object: shelf", "object: shell", "'handles.door.object'.*'shell'.*'shelf'"),
    ("link: handle", "link: knob", "'handles.door.link'.*'knob'"),
    ("0.4]}", "0.4], joints: {hinge: -1}}", "joints': hinge.*-1"),
    ("0.4]}", "0.4], joints: {door_to_handle: 0}}", "'door_to_handle'"),
])  # fmt: skip
def test_an_invalid_scene_is_an_error_with_its_key(write, old, new, where):
    path = write(old, new)
    with pytest.raises(KinfeasError, match=f"^{path}: .*{where}"):
        read_scene(path)


LINK = "<robot name='a'><link name='a'>{}</link></robot>"
MESH = "<collision><geometry><mesh filename='a.stl'/></geometry></collision>"


@pytest.mark.parametrize(("content", "where"), [("", "<collision>"), (MESH, "'a'")])
def test_furniture_is_made_of_primitives(write, tmp_path, content, where):
    (tmp_path / "own.urdf").write_text(LINK.format(content))
    with pytest.raises(KinfeasError, match=rf"own\.urdf: .*{where}"):
        read_scene(write("table.urdf", "own.urdf"))
