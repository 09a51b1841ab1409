import numpy as np
import pytest

from kinfeas.core.checks import CheckedMotion
from kinfeas.core.spatial import IDENTITY
from kinfeas.plugins.linear import Linear
from kinfeas.scenes.scene import read_scene
from kinfeas.testing.rules import Trial, sample_motions
from kinfeas.viz.drawing import scene_figure
from kinfeas.viz.plots import motion_figure
from kinfeas.viz.shapes import corners, robot_solids, scene_solids
from kinfeas.viz.style import ARM, BODY


@pytest.mark.parametrize("limit", [0.1, None])
def test_paths_speeds_and_limits_are_drawn(limit):
    trial = Trial(duration=5.0, max_velocity=limit)
    samples = sample_motions(CheckedMotion(Linear()), trial)
    above, _, speed, _ = motion_figure("linear", samples, trial).axes
    assert len(above.lines) == 3 * 12
    assert len(speed.lines) == 12 + (limit is not None)


def test_a_robot_has_an_arm_and_a_body_above_the_floor(robot):
    solids = robot_solids(robot, IDENTITY, robot.home["home"])
    points = corners(solids)
    assert {solid.colour for solid in solids} == {ARM, BODY}
    assert -0.05 < points[:, 2].min() < 0.5 < points[:, 2].max() < 2.2


def test_a_scene_has_its_objects_and_the_paths_of_its_handles():
    room = read_scene("room")
    (axes,) = scene_figure(room).axes
    assert {text.get_text() for text in axes.texts} == set(room.objects) - {"walls"}
    paths = [line.get_data_3d() for line in axes.lines if len(line.get_data_3d()[0]) > 1]
    ends = {tuple(np.round([axis[0] for axis in path], 6)) for path in paths}
    assert ends == {tuple(np.round(room.handle_pose(name)[:3], 6)) for name in room.handles}


def test_furniture_has_the_colours_of_its_urdf_or_is_grey(tmp_path):
    box = '<geometry><box size="0.1 0.1 0.1"/></geometry>'
    red = f'<visual>{box}<material name=""><color rgba="1 0 0 1"/></material></visual>'
    for name, visual in (("red", red), ("bare", "")):
        link = f'<link name="a">{visual}<collision>{box}</collision></link>'
        (tmp_path / f"{name}.urdf").write_text(f'<robot name="a">{link}</robot>')
    red, bare = (f"{{urdf: {name}.urdf, position: [{x}, 0, 0.05]}}" for x, name in
                 enumerate(("red", "bare")))  # fmt: skip
    scene = f"{{name: a, size: [4, 4], objects: {{red: {red}, bare: {bare}}}}}"
    (tmp_path / "scene.yaml").write_text(scene)
    scene = read_scene(str(tmp_path / "scene.yaml"))
    solids = {solid.link[0]: solid for solid in scene_solids(scene)}
    assert solids["red"].colour == "#ff0000"
    assert len({solids["bare"].colour[i : i + 2] for i in (1, 3, 5)}) == 1


def test_pages_are_self_contained(hsr, recordings):
    pytest.importorskip("viser")
    from kinfeas.viz.pages import replay_html, scene_html
    from kinfeas.viz.replay import replay_of

    replay = replay_of(recordings[0], hsr, "HSR")
    for html in (scene_html(read_scene("room")), replay_html(replay)):
        assert html.lstrip().lower().startswith("<!doctype html")
        assert "<title>kinfeas: " in html
        assert not any(place in html for place in ('src="http', "src='http", 'href="http'))
