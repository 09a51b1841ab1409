from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, make_pose, planar_pose, rotation
from kinfeas.scenes.scene import read_scene

# From the method: metres, in the world.
HINGE, DOOR_HANDLE, DRAWER_HANDLE = (0.185, 2.829), (-0.130, 2.796, 0.618), (-2.81, 0.015, 0.525)


def corners(one):
    """Return the corners (k, 3) of all boxes of an object, in the world."""
    unit = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    placed = [
        rotation(shape.pose).apply(unit * shape.size) + shape.pose[:3]
        for _, shape in one.shapes()
        if shape.kind == "box"
    ]
    return np.concatenate(placed)


def test_the_room_is_ten_metres_square_with_walls_of_two(room):
    assert room.size == (10.0, 10.0)
    points = corners(room.objects["walls"])
    assert points[:, 2].min() == pytest.approx(0.0)
    assert points[:, 2].max() == pytest.approx(2.0)
    assert np.abs(points[:, :2]).max(axis=1).min() == pytest.approx(5.0)


@pytest.mark.parametrize(("name", "centre"), [("pick_table", (3.0, 0.0)), ("place_table", None)])
def test_tables_are_as_the_method_has_them(room, name, centre):
    table = room.objects[name]
    points = corners(table)
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.75, 0.75, 0.52], atol=1e-9)
    assert points[:, 2].max() == pytest.approx(0.52)
    np.testing.assert_allclose(table.pose[:2], centre or (0.25, -2.75))


def test_the_box_stands_on_the_near_edge_of_its_table(room):
    box = room.objects["box"]
    assert not box.fixed
    points = corners(box)
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.05, 0.15, 0.23], atol=1e-9)
    assert points[:, 2].min() == pytest.approx(0.52)
    assert points[:, 0].mean() == pytest.approx(2.725)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_shelves_are_two_bodies_on_one_another(room, name):
    low, high = corners(room.objects[f"{name}_base"]), corners(room.objects[f"{name}_shelf"])
    centre = {"door": (0.0, 3.0), "drawer": (-3.0, 0.0)}[name]
    np.testing.assert_allclose((low.min(axis=0) + low.max(axis=0))[:2] / 2.0, centre, atol=1e-9)
    assert low[:, 2].max() == pytest.approx(high[:, 2].min()) == pytest.approx(0.24 + 0.205)
    assert high[:, 2].max() == pytest.approx(0.65 + 0.205)
    assert sorted(np.ptp(low, axis=0)[:2]) == pytest.approx([0.39, 0.415])


def test_handles_are_where_the_method_has_them(room):
    door, drawer = room.handle_pose("door"), room.handle_pose("drawer")
    np.testing.assert_allclose(door[:3], DOOR_HANDLE, atol=1e-9)
    np.testing.assert_allclose(drawer[:3], DRAWER_HANDLE, atol=1e-9)
    # x is the approach: away from the room's middle.
    np.testing.assert_allclose(rotation(door).apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(rotation(drawer).apply([1.0, 0.0, 0.0]), [-1.0, 0.0, 0.0], atol=1e-9)
    for pose in (door, drawer):
        np.testing.assert_allclose(rotation(pose).apply([0.0, 0.0, 1.0]), [0.0, 0.0, 1.0])


def test_handles_know_the_joints_that_they_move(room):
    assert room.handles["door"].joint == "hinge"
    assert room.handles["drawer"].joint == "slide"


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
    moved.check()


def test_what_a_task_moves_into_something_is_found(room):
    pose = make_pose(np.array([2.725, 0.0, 0.5]), rotation(room.objects["box"].pose))
    with pytest.raises(KinfeasError, match="'pick_table' and 'box' stand within each other"):
        room.with_poses({"box": pose}).check()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda room: room.with_poses({"boxx": None}), "no object 'boxx'.*mean 'box'"),
        (lambda room: room.with_joints({"door": {}}), "no object 'door'"),
        (lambda room: room.with_joints({"door_shelf": {"slide": 0.0}}), "no moving joint 'slide'"),
        (lambda room: room.with_joints({"door_shelf": {"hinge": 2.0}}), r"in \[0, 1.92\], not 2"),
        (lambda room: room.handle_pose("dor"), "no handle 'dor'.*mean 'door'"),
    ],
)
def test_unknown_names_are_refused(room, change, message):
    with pytest.raises(KinfeasError, match=message):
        change(room)


def test_a_user_writes_a_scene_with_shipped_furniture(write):
    scene = read_scene(write())
    assert scene.name == "mine"
    assert list(scene.objects) == ["table", "shelf"]
    assert scene.objects["shelf"].joint_positions == {"hinge": 0.0}


def test_the_documented_scene_is_one(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
    path = tmp_path / "kitchen.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0])
    assert list(read_scene(str(path)).objects) == ["table", "cupboard", "mug"]


def test_a_user_brings_furniture(write, tmp_path, room):
    own = room.objects["pick_table"]
    (tmp_path / "bench.urdf").write_text(own.urdf_path.read_text())
    scene = read_scene(write("table.urdf", "bench.urdf"))
    assert scene.objects["table"].urdf_path == tmp_path / "bench.urdf"
    assert scene.objects["table"].mass == own.mass


@pytest.mark.parametrize("folder", ["parts", "parts/../parts", "."])
def test_furniture_may_lie_in_another_folder(write, tmp_path, room, folder):
    own = room.objects["pick_table"].urdf_path.read_text()
    (tmp_path / "parts").mkdir()
    (tmp_path / folder / "bench.urdf").write_text(own)
    for name in (f"{folder}/bench.urdf", f"{tmp_path}/{folder}/bench.urdf"):
        found = read_scene(write("table.urdf", name)).objects["table"].urdf_path
        assert found.samefile(tmp_path / folder / "bench.urdf")


def test_only_a_bare_name_is_that_of_a_shipped_urdf(write):
    with pytest.raises(KinfeasError, match=r"there is no file '.*parts/table\.urdf'"):
        read_scene(write("table.urdf", "parts/table.urdf"))
    with pytest.raises(KinfeasError, match="cannot be read: File name too long"):
        read_scene(write("table.urdf", f"{'a' * 300}.urdf"))


def test_overrides_win(write):
    scene = read_scene(write(), ["objects.shelf.joints.hinge=0.5"])
    assert scene.objects["shelf"].joint_positions == {"hinge": 0.5}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("table.urdf", "tabel.urdf", "'objects.table.urdf': there is no file .*tabel.urdf'; ship"),
        ("table.urdf", "../box.urdf", "there is no file"),
        (
            "object: shelf",
            "object: shell",
            "'handles.door.object': there is no object 'shell' .*'s",
        ),
        (
            "link: handle",
            "link: knob",
            "'handles.door.link': 'shelf' has no link 'knob'; known are",
        ),
        ("urdf: table.urdf, ", "", "'objects.table.urdf' is missing"),
        ("position: [1.0,", "place: [1.0,", "unknown key 'objects.table.place'"),
        ("[1.0, 0.0, 0.0]", "[1.0, 0.0]", "'objects.table.position' must be a list of 3"),
        ("[1.0, 0.0, 0.0]", "[[0.0, 1.0], 0.0, 0.0]", "must be a number in"),
        ("4.0, 3.0", "4.0, 0.0", r"size.1' must be a number in \(0, 10000\]"),
        ("0.4]}", "0.4], joints: {hinge: -1}}", r"joints': hinge must be in \[0, 1.92\], not -1"),
        ("0.4]}", "0.4], joints: {slide: 0}}", "no moving joint 'slide'; known are hinge"),
        ("0.4]}", "0.4], joints: {door_to_handle: 0}}", "no moving joint 'door_to_handle'"),
    ],
)
def test_wrong_scenes_are_refused_in_one_line(write, old, new, message):
    path = write(old, new)
    with pytest.raises(KinfeasError, match=message) as caught:
        read_scene(path)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)


def test_unknown_scenes_are_refused(tmp_path):
    with pytest.raises(KinfeasError, match=r"unknown scene 'rom'.*mean 'room'.*path of a YAML"):
        read_scene("rom")
    with pytest.raises(KinfeasError, match="cannot be read"):
        read_scene(str(tmp_path / "none.yaml"))


def test_a_broken_urdf_and_meshes_are_refused(write, tmp_path):
    path = write("table.urdf", "own.urdf")
    (tmp_path / "own.urdf").write_text("<robot name='a'><link name='a'>")
    with pytest.raises(KinfeasError, match=r"own\.urdf: not XML"):
        read_scene(path)
    (tmp_path / "own.urdf").write_text("<robot name='a'><link name='a'/></robot>")
    with pytest.raises(KinfeasError, match=r"own\.urdf: has no <collision>"):
        read_scene(path)
    mesh = "<collision><geometry><mesh filename='a.stl'/></geometry></collision>"
    (tmp_path / "own.urdf").write_text(f"<robot name='a'><link name='a'>{mesh}</link></robot>")
    with pytest.raises(KinfeasError, match="link 'a' has a collision mesh, only boxes"):
        read_scene(path)


def test_a_joint_that_follows_another_one_is_refused(write, tmp_path, room):
    path = write("shelf_with_door.urdf", "own.urdf")
    own = room.objects["door_shelf"].urdf_path.read_text()
    mimic = own.replace(
        '<joint name="door_to_handle" type="fixed">',
        '<joint name="door_to_handle" type="continuous"><mimic joint="hinge"/>',
    )
    assert mimic != own
    (tmp_path / "own.urdf").write_text(mimic)
    with pytest.raises(
        KinfeasError, match=r"own\.urdf: joint 'door_to_handle' follows 'hinge', by"
    ):
        read_scene(path)
