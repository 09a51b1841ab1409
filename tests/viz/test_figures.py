import numpy as np
import pytest

from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.drawing import scene_solids
from kinfeas.viz.figures import robot_figure, scene_figure
from kinfeas.viz.style import png


def titles(figure):
    return [axes.get_title() for axes in figure.axes]


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_a_robot_is_drawn_from_two_sides(name):
    figure = robot_figure(load_robot(name))
    assert len(figure.axes) == 2
    assert png(figure, dpi=60).startswith(b"\x89PNG")


def test_every_handle_has_a_close_view():
    room = read_scene("room")
    figure = scene_figure(room)
    assert [title.split(":")[0] for title in titles(figure)] == ["room", "door", "drawer"]
    labels = {text.get_text() for text in figure.axes[0].texts}
    assert labels == set(room.objects) - {"walls"}
    assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_body_leaf_and_handle_differ_in_colour():
    colours = {}
    for name, solid in scene_solids(read_scene("room")):
        colours.setdefault(name, set()).add(solid.colour)
    assert len(colours["door_shelf"]) == len(colours["drawer_shelf"]) == 3
    assert colours["pick_table"] == colours["place_table"] != colours["walls"]


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
    assert titles(scene_figure(scene))[1:] == ["knob: j", "post"]
    assert np.isfinite(scene.handle_pose("knob")).all()
