from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.importer.draft import stated
from kinfeas.importer.reach import (
    Heights,
    built_to_touch,
    comfortable,
    free_share,
    freedom,
    useful_heights,
    with_pairs,
)
from kinfeas.importer.text import Guesses, robot_yaml
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.self_collision import build_collision_model, self_collides
from kinfeas.robots.loading import load_robot, read_robot
from kinfeas.robots.spec import PoseTolerance
from kinfeas.robots.urdf import parse_urdf

HEIGHTS = np.arange(6.0)


@pytest.fixture(params=["tiago", "hsr"])
def robot(request):
    return load_robot(request.param)


def test_shipped_robots_have_no_more_pairs_to_leave_out(robot):
    assert not built_to_touch(robot)


def test_what_may_touch_need_not_be_told(robot):
    told = {tuple(sorted(pair)) for pair in robot.ignored_collisions}
    bare = replace(robot, ignored_collisions=frozenset())
    found = built_to_touch(bare)
    assert set(found) <= told
    assert all(0.0 < share <= 1.0 for share in found.values())
    assert free_share(with_pairs(bare, found)) > 0.3


def test_a_home_is_within_limits_free_and_ahead(robot):
    home = comfortable(robot)
    lower, upper = robot.finite_joint_limits
    assert np.all((lower <= home) & (home <= upper))
    assert not self_collides(build_collision_model(robot), home)
    assert forward(build_chain(robot), home)[0] > 0.0


def test_a_robot_that_always_touches_itself_is_one_sentence(robot, monkeypatch):
    monkeypatch.setattr(
        "kinfeas.importer.reach.self_collides", lambda model, joints: np.ones(len(joints), bool)
    )
    with pytest.raises(KinfeasError, match="in all of 4096 configurations it touches itself"):
        comfortable(robot)


@pytest.mark.parametrize(
    ("share", "least", "band"),
    [
        ([0, 1, 1, 1, 0, 0], 0.5, (1.0, 3.0)),
        ([1, 1, 0, 1, 1, 1], 0.5, (3.0, 5.0)),
        ([0, 1, 0, 0, 0, 0], 0.5, None),
        ([0, 0, 0, 0, 0, 0], 0.5, None),
        ([0.2, 0.9, 0.7, 0.9, 0.95, 0.9], 0.8, (3.0, 5.0)),
    ],
)
def test_a_band_is_the_largest_range_of_heights(share, least, band):
    assert Heights(HEIGHTS, np.array(share, dtype=float)).band(least) == band


@pytest.mark.slow
def test_useful_heights_are_those_of_the_robots_file():
    told = []
    robot = load_robot("tiago")
    heights = useful_heights(robot, told.append)
    assert sum(told) == pytest.approx(1.0)
    low, high = robot.goal_heights["ggr_restricted"]
    inside = (heights.at >= low) & (heights.at <= high)
    assert np.all(heights.share[inside] > 0.9)
    assert heights.share[heights.at > 1.8].max(initial=0.0) < 0.5


def test_lengths_in_millimetres_are_one_sentence():
    """Of that many heights the trial would take a day."""
    robot = load_robot("tiago")
    lift = replace(robot.urdf.joints["torso_lift_joint"], origin=np.array([0, 0, 790, 0, 0, 0, 1]))
    urdf = replace(robot.urdf, joints=robot.urdf.joints | {lift.name: lift})
    with pytest.raises(KinfeasError, match=r"tiago: the hand gets 79\d m high, at most 100 are"):
        useful_heights(replace(robot, urdf=urdf))


def test_leeway_makes_no_height_useful(monkeypatch):
    """A goal counts within the same distance for every robot."""
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4,))
    robot = load_robot("hsr")
    wide = replace(robot, pose_tolerance=PoseTolerance(position=1.0, rotation=3.0))
    shares = [useful_heights(one).share for one in (robot, wide)]
    np.testing.assert_array_equal(*shares)
    assert shares[0].max() > 0.5


def test_an_arm_has_the_freedom_of_its_hand(robot):
    assert freedom(robot) == (6 if robot.name == "tiago" else 5)


@pytest.fixture
def drafted(tmp_path):
    """Return a function that reads a URDF as a robot, before anything is tried out."""

    def read(path):
        urdf = parse_urdf(path)
        arm = find_arm(urdf, None, "dolly")
        spec = stated("dolly", urdf, arm, read_hand(urdf, arm), "differential")
        (tmp_path / "dolly.yaml").write_text(robot_yaml(replace(spec, urdf=path), Guesses()))
        return read_robot(tmp_path / "dolly.yaml")

    return read


def test_sliders_in_line_are_one_freedom(changed, drafted):
    slides = 'name="{}" type="prismatic"'
    path = changed(
        ('name="lift" type="revolute"', slides.format("lift")),
        ('name="elbow" type="revolute"', slides.format("elbow")),
        ('lower="-1e16" upper="1e16"', 'lower="0" upper="0.3"'),
    )
    assert freedom(drafted(path)) == 2


def test_fingers_stand_still_and_keep_no_links_apart(changed, drafted):
    wide = '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
    path = changed(
        ('<link name="lower"/>', f'<link name="lower">{wide}</link>'),
        ('name="l" type="prismatic"', 'name="l" type="revolute"'),
        ('name="r" type="prismatic"', 'name="r" type="revolute"'),
    )
    found = built_to_touch(drafted(path))
    assert 1.0 / 3.0 < found["left", "lower"] < 0.95


def test_the_home_of_an_arm_with_less_freedom_is_off_its_limits():
    robot = load_robot("hsr")
    lower, upper = robot.finite_joint_limits
    home = comfortable(robot)
    assert np.all((home - lower > 0.02 * (upper - lower)) & (upper - home > 0.02 * (upper - lower)))
