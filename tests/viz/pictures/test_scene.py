import numpy as np
import pytest

from kinfeas.scenes.scene import read_scene
from kinfeas.viz.pictures.scene import painted_shapes, scene_figure
from kinfeas.viz.pictures.style import png

BARE = """
name: bare
size: [2.0, 2.0]
objects:
  table: {urdf: table.urdf}
"""


@pytest.fixture(scope="module")
def room():
    return read_scene("room")


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_every_handle_has_a_view_of_its_own(room):
    figure = scene_figure(room)
    assert titles(figure) == [
        "room: 10 x 10 m, grid of 1 m",
        "door: hinge of 110 degrees",
        "drawer: slide of 0.35 m",
    ]
    assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_what_stands_on_one_another_is_named_together(room):
    texts = {text.get_text() for text in scene_figure(room).axes[0].texts}
    assert texts == {
        "place_table",
        "box\npick_table",
        "door_shelf\ndoor_base",
        "drawer_shelf\ndrawer_base",
    }


def test_a_scene_without_handles_is_drawn_alone(tmp_path):
    path = tmp_path / "bare.yaml"
    path.write_text(BARE)
    assert titles(scene_figure(read_scene(str(path)))) == ["bare: 2 x 2 m, grid of 1 m"]


def test_body_leaf_and_handle_differ_in_colour(room):
    colours = {}
    for name, _, colour in painted_shapes(room):
        colours.setdefault(name, set()).add(colour)
    assert len(colours["door_shelf"]) == len(colours["drawer_shelf"]) == 3
    assert colours["pick_table"] == colours["place_table"] != colours["walls"]


def test_a_continuous_joint_and_an_absent_one_are_drawn_too(tmp_path):
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
    assert scene.handles["post"].joint is None
    assert titles(scene_figure(scene))[1:] == ["knob: j without end", "post"]
    assert np.isfinite(scene.handle_pose("knob")).all()
