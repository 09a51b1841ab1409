import numpy as np

from kinfeas.scenes.scene import read_scene
from kinfeas.viz.figures import robot_figure, scene_figure
from kinfeas.viz.style import png


def test_a_robot_is_drawn_from_two_sides(robot):
    figure = robot_figure(robot)
    assert len(figure.axes) == 2
    assert png(figure, dpi=60).startswith(b"\x89PNG")


def test_a_scene_has_its_objects_and_the_paths_of_its_handles():
    room = read_scene("room")
    figure = scene_figure(room)
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts} == set(room.objects) - {"walls"}
    paths = [line.get_data_3d() for line in axes.lines if len(line.get_data_3d()[0]) > 1]
    assert len(paths) == len(room.handles) == 2
    ends = {tuple(np.round([axis[0] for axis in path], 6)) for path in paths}
    assert ends == {tuple(np.round(room.handle_pose(name)[:3], 6)) for name in room.handles}
    assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_continuous_and_fixed_handles_are_drawn(tmp_path):
    box = "<collision><geometry><box size='.2 .2 .6'/></geometry></collision>"
    knob = "<collision><geometry><sphere radius='.02'/></geometry></collision>"
    knob += "<inertial><mass value='.1'/><inertia ixx='1e-5' iyy='1e-5' izz='1e-5'/></inertial>"
    joint = "<parent link='a'/><child link='b'/><origin xyz='-.12 0 0'/><axis xyz='1 0 0'/>"
    (tmp_path / "knob.urdf").write_text(
        f"<robot name='r'><link name='a'>{box}</link><link name='b'>{knob}</link>"
        f"<joint name='j' type='continuous'>{joint}</joint></robot>"
    )
    path = tmp_path / "own.yaml"
    path.write_text(
        "{name: own, size: [4, 4], objects: {post: {urdf: knob.urdf, position: [0, 0, 0.3]}}, "
        "handles: {knob: {object: post, link: b}, post: {object: post, link: a, "
        "position: [-0.15, 0, 0.2]}}}"
    )
    scene = read_scene(str(path))
    (axes,) = scene_figure(scene).axes
    assert all(len(line.get_data_3d()[0]) == 1 for line in axes.lines)  # points, no paths
    assert np.isfinite(scene.handle_pose("knob")).all()
