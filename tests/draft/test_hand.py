import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas import registry
from kinfeas.draft.arm import find_arm
from kinfeas.draft.hand import read_hand
from kinfeas.robots.urdf import parse_urdf


def hand_of(path):
    urdf = parse_urdf(path)
    return read_hand(urdf, find_arm(urdf, None, "dolly"))


@pytest.mark.parametrize("name", ["pr2", "hsr"])
def test_shipped_hands_point_where_their_files_say(name):
    robot = registry.load_robot(name)
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
