import pytest

from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.importer.draft import stated
from kinfeas.importer.text import Guesses, robot_yaml
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf import parse_urdf

LIMITS = 'lower="-2" upper="2"'
"""Of the joint `lift`."""


def stated_of(path):
    urdf = parse_urdf(path)
    arm = find_arm(urdf, None, "dolly")
    return stated("dolly", urdf, arm, read_hand(urdf, arm), "differential")


@pytest.mark.parametrize(
    ("limits", "turn"),
    [
        ((-1e16, 1e16), (-3.1416, 3.1416)),
        ((-1.0, 20.0), (-1.0, 5.2832)),
        ((0.0, 13.0), (0.0, 6.2832)),
        ((-13.00003, -0.00003), (-6.2832, -0.00003)),
        ((-6.3, 6.27), None),
    ],
)
def test_a_joint_of_more_than_two_turns_gets_one_within_its_limits(changed, limits, turn):
    lower, upper = limits
    told = stated_of(changed((LIMITS, f'lower="{lower}" upper="{upper}"'))).arm["lift"]
    assert told.soft_limits == (turn and pytest.approx(turn, abs=1e-9))
    if turn is not None:
        assert lower <= told.soft_limits[0] < told.soft_limits[1] <= upper


def test_a_safety_controllers_limits_need_no_others(changed):
    wide = (f'{LIMITS} velocity="1.5"/>', 'lower="-99" upper="99" velocity="1.5"/>')
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1"/>'
    assert stated_of(changed(wide)).arm["lift"].soft_limits == (-3.1416, 3.1416)
    assert stated_of(changed((wide[0], wide[1] + soft))).arm["lift"].soft_limits is None


@pytest.mark.parametrize(
    ("velocity", "guess"), [("1.5", None), ("1000", None), ("0", 1.0), ("1001", 1.0), ("1e16", 1.0)]
)
def test_what_stands_for_no_speed_is_guessed(changed, velocity, guess):
    path = changed(('velocity="1.5"', f'velocity="{velocity}"'))
    assert stated_of(path).arm["lift"].velocity == guess


def test_a_joint_that_is_followed_from_off_the_way_stands_still():
    urdf = load_robot("pr2").urdf
    arm = find_arm(urdf, "r_gripper_r_finger_tip_link", "pr2")
    told = stated("pr2", urdf, arm, read_hand(urdf, arm), "omnidirectional")
    assert "r_gripper_r_finger_joint" not in told.arm  # which follows the other finger's
    assert told.fixed_joints == {"r_gripper_l_finger_joint": 0.0}
    guessed = "  r_gripper_l_finger_joint: 0  # rad, guess\n"
    assert guessed in robot_yaml(told, Guesses())


@pytest.mark.parametrize("at", [0.0, 1.23456789])
def test_a_joint_without_room_stands_where_it_has_to(changed, at):
    told = stated_of(changed((LIMITS, f'lower="{at}" upper="{at}"')))
    assert list(told.arm) == ["pan", "elbow"]
    assert told.fixed_joints == {"lift": at, "l": 0.02, "r": 0.02}
