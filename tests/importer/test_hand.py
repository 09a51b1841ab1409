import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf import parse_urdf


def hand_of(path):
    urdf = parse_urdf(path)
    return read_hand(urdf, find_arm(urdf, None, "dolly"))


def axes(hand):
    """The approach, from finger to finger, and the third, as columns."""
    return Rotation.from_quat(hand.rotation).inv().as_matrix()


@pytest.mark.parametrize("name", ["pr2", "hsr"])
def test_shipped_hands_point_where_their_files_say(name):
    robot = load_robot(name)
    hand = read_hand(robot.urdf, find_arm(robot.urdf, robot.ee_frame, name))
    found, known = (
        Rotation.from_quat(quaternion).inv().as_matrix()
        for quaternion in (hand.rotation, robot.gripper_rotation)
    )
    np.testing.assert_allclose(found[:, 0], known[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(found[:, 1]), np.abs(known[:, 1]), atol=1e-9)
    np.testing.assert_allclose(hand.tip, robot.tool_tip, atol=0.03)


def test_reads_fingers_and_tip(dolly):
    hand = hand_of(dolly)
    np.testing.assert_allclose(hand.tip, [0.12, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(hand.rotation, [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    assert (hand.gripper.fingers, hand.gripper.effort) == (("l", "r"), 20.0)
    assert (hand.gripper.closed, hand.gripper.open) == (0.0, 0.04)


def test_the_end_at_which_the_fingers_are_nearer_is_closed(changed):
    outside = [
        ('xyz="0.02 0.01 0"', 'xyz="0.02 -0.06 0"'),
        ('xyz="0.02 -0.01 0"', 'xyz="0.02 0.06 0"'),
    ]
    gripper = hand_of(changed(*outside)).gripper
    assert (gripper.closed, gripper.open) == (0.04, 0.0)


@pytest.mark.parametrize(
    "change",
    [
        ('upper="0.04" velocity="0.1" effort="20"', 'upper="0.05" velocity="0.1" effort="20"'),
        ('effort="20"', 'effort="0"'),
        ('effort="20"/>', 'effort="20"/><mimic joint="l" multiplier="-1"/>'),
    ],
)
def test_fingers_that_the_file_has_no_words_for_are_left_out(changed, change):
    assert hand_of(changed(change)).gripper is None


def test_a_hand_without_fingers_approaches_toward_its_farthest_shape(changed):
    fixed = [(f'name="{name}" type="prismatic"', f'name="{name}" type="fixed"') for name in "lr"]
    hand = hand_of(changed(*fixed))
    assert hand.gripper is None
    np.testing.assert_allclose(hand.tip, [0.12, 0.0, 0.0], atol=1e-9)


def test_a_single_jaw_tells_which_way_it_closes(changed):
    fixed = ('name="r" type="prismatic"', 'name="r" type="fixed"')
    assert hand_of(changed(fixed)).gripper is None
    np.testing.assert_allclose(axes(hand_of(changed(fixed)))[:, 1], [0.0, 1.0, 0.0], atol=1e-9)
    turns = ('name="l" type="prismatic"', 'name="l" type="revolute"')
    up = changed(
        fixed,
        turns,
        (
            '<axis xyz="0 1 0"/>\n    <limit lower="0" upper="0.04"',
            '<axis xyz="0 1 0"/>\n    <limit lower="0" upper="0.4"',
        ),
    )
    np.testing.assert_allclose(axes(hand_of(up)), np.eye(3)[:, [0, 2, 1]] * [1, 1, -1], atol=1e-9)


@pytest.mark.parametrize("axis", ["1 0 0", "-1 0 0"])
def test_a_flange_points_away_from_what_carries_it(changed, axis):
    shape = (
        '<collision><origin xyz="{}"/><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    )
    path = changed(
        ('name="l" type="prismatic"', 'name="l" type="fixed"'),
        ('name="r" type="prismatic"', 'name="r" type="fixed"'),
        ('origin xyz="0.05 0 0"', 'origin xyz="-0.1 0 0"'),
        ('<link name="wrist"/>', f'<link name="wrist">{shape.format("0.1 0.2 0")}</link>'),
        ('name="mount" type="fixed"', 'name="mount" type="continuous"'),
        ('<axis xyz="0 0 0"/>', f'<axis xyz="{axis}"/>'),
    )
    np.testing.assert_allclose(axes(hand_of(path))[:, 0], [1.0, 0.0, 0.0], atol=1e-9)


def test_fingers_in_line_with_the_approach_still_make_a_frame(changed):
    on_line = [('xyz="0.02 0.01 0"', 'xyz="0.02 0 0"'), ('xyz="0.02 -0.01 0"', 'xyz="0.06 0 0"')]
    along = [
        ('<axis xyz="0 1 0"/>\n    <limit lower="0"', '<axis xyz="1 0 0"/>\n    <limit lower="0"')
    ]
    along.append(('<axis xyz="0 -1 0"/>', '<axis xyz="1 0 0"/>'))
    found = axes(hand_of(changed(*on_line, *along)))
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found[:, 0], [1.0, 0.0, 0.0], atol=1e-9)
