from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.run_log import REACHED, About, Record
from kinfeas.robots.elements import parse_xml
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.episodes import episodes_figure, moments
from kinfeas.viz.replay import as_recording
from kinfeas.viz.shapes import far_end, urdf_visuals


@pytest.fixture
def record(hsr):
    def make(t=40, event=REACHED):
        joints = tuple(joint.name for joint in hsr.arm)
        pose = np.zeros((t, 7))
        pose[:, 0], pose[:, 6] = np.linspace(0.0, 1.0, t), 1.0
        home = np.tile(hsr.home["home"], (t, 1))
        subgoal = (np.arange(t) * 2) // t
        goal = pose[-1] + subgoal[:, np.newaxis] * [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        return Record(
            About("hsr", "two", "pretrained", "analytic", 0.02, joints, "now"),
            0.02 * np.arange(t), np.full(t, np.nan), pose, home, pose + 0.0, goal,
            np.zeros((t, 6)), home, np.arange(t) % 7 > 0, subgoal,
            ("start", *[""] * (t - 2), event)[-t:],
        )  # fmt: skip

    return make


def test_a_record_is_an_episode(hsr, record):
    episode = as_recording(record(), hsr)
    assert episode.reached
    assert episode.goals.tolist() == [[1, 0, 0, 0, 0, 0, 1], [1, 1, 0, 0, 0, 0, 1]]
    assert episode.ee_pose.shape == (40, 7)
    assert not as_recording(record(event=""), hsr).reached
    assert as_recording(record(event=f"{REACHED}, task done"), hsr).reached
    line = (0.5, 0.1, 0.3, 0.2, 0.2, 0.0, 0.4, 1.0, 0.1, 0.0, 2.0)
    among = as_recording(replace(record(), about=replace(record().about, solids=(line,))), hsr)
    assert among.solids.table.tolist() == [list(line)]
    other = replace(record(), about=replace(record().about, joints=("a", "b")))
    with pytest.raises(KinfeasError, match="joints a, b"):
        as_recording(other, hsr)


@pytest.mark.parametrize(("height", "x", "named"), [
    (1.0, 0.5, {"solid"}), (2.0, 0.5, {"wall"}), (2.0, 9.0, set()),
])  # fmt: skip
def test_the_legend_names_what_is_drawn(hsr, record, height, x, named):
    line = (x, 0.1, 0.3, 0.2, 0.2, 0.0, height, 1.0, 0.1, 0.0, 0.0)
    about = replace(record().about, solids=(line,))
    recording = as_recording(replace(record(), about=about), hsr)
    assert legend(hsr, recording) & {"robot", "solid", "wall"} == {"robot", *named}
    assert "no IK solution" in legend(hsr, recording)
    feasible = replace(recording, feasible=np.ones_like(recording.feasible))
    assert "no IK solution" not in legend(hsr, feasible)


def legend(robot, recording):
    figure = episodes_figure(robot, [recording])
    return {text.get_text() for text in figure.legends[0].get_texts()}


@pytest.mark.parametrize(("stop", "expected"), [(0.0, [0, 39]), (0.5, [0, 39]), (2.0, [0, 20, 39])])
def test_moments_have_both_ends(hsr, record, stop, expected):
    episode = as_recording(record(), hsr)
    path = np.minimum(episode.base_pose * 2.0, stop)
    assert moments(replace(episode, base_pose=path)).tolist() == expected


def test_joints_move_to_their_farther_limit():
    joint = read_scene("room").objects["door_shelf"].urdf.joints["hinge"]
    door, wheel = replace(joint, lower=-1.9, upper=0.0), replace(joint, lower=-np.inf, upper=np.inf)
    assert (far_end(joint, 0.0), far_end(door, 0.0), far_end(door, -1.9)) == (joint.upper, -1.9, 0)
    assert np.isfinite(far_end(wheel, 0.0))


def test_colours_beyond_their_range_are_clipped():
    colour = '<material name="a"><color rgba="255 0 -1 1"/></material>'
    visual = f'<visual><geometry><sphere radius="1"/></geometry>{colour}</visual>'
    urdf = parse_xml(f'<robot name="r"><link name="l">{visual}</link></robot>', "robot", "r.urdf")
    assert [shape.colour for shape in urdf_visuals("r", urdf)] == ["#ff0000"]
