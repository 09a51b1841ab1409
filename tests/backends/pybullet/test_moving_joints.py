import pytest

from kinfeas.backends.pybullet.robot_body import (
    Follower,
    arm_followers,
    finger_followers,
    moving_joints,
)
from kinfeas.robots.loading import load_robot


def test_arm_and_fingers_move_and_nothing_else():
    robot = load_robot("tiago")
    fingers = {"gripper_left_finger_joint", "gripper_right_finger_joint"}
    assert moving_joints(robot) == {joint.name for joint in robot.arm} | fingers


def test_the_torso_of_the_hsr_follows_its_arm():
    followers = arm_followers(load_robot("hsr"))
    assert followers == (Follower("torso_lift_joint", "arm_lift_joint", 0.5, 0.0),)


def test_finger_tips_follow_their_own_finger():
    followers = {one.name: one for one in finger_followers(load_robot("pr2"))}
    assert sorted(followers) == ["r_gripper_l_finger_tip_joint", "r_gripper_r_finger_tip_joint"]
    assert followers["r_gripper_r_finger_tip_joint"].leader == "r_gripper_r_finger_joint"


def test_offsets_are_kept():
    for one in finger_followers(load_robot("hsr")):
        assert (one.multiplier, one.offset) == (-1.0, pytest.approx(-0.087))
