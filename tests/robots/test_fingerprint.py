from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.spatial import make_pose, rotation
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import fingerprint

# A policy file is refused where these have changed, so they may change with a robot only.
KNOWN = {
    "pr2": "sha256:4cc5c688f1cf919bdf0619051a89089c00006cbffbd35df32d6c6c326eb794ec",
    "tiago": "sha256:b4ed2eee5e8e022bb02865c7c820859c62ee2397c170c7c072d3519558b00d30",
    "hsr": "sha256:619dc04fe5826c6529f7ae8bc1c879dfee07299e4eab23793e96400f10ba315c",
}


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


def test_stays_what_it_is(robot):
    assert fingerprint(robot) == KNOWN[robot.name]


def with_joint(robot, name, **changes):
    joints = dict(robot.urdf.joints)
    joints[name] = replace(joints[name], **changes)
    return replace(robot, urdf=replace(robot.urdf, joints=joints))


def with_arm(robot, **changes):
    return replace(robot, arm=(replace(robot.arm[0], **changes), *robot.arm[1:]))


def moved(robot, name, metres):
    origin = robot.urdf.joints[name].origin.copy()
    origin[2] += metres
    return with_joint(robot, name, origin=origin)


OTHER = {
    "velocity": lambda r: replace(r, base=replace(r.base, max_velocity=0.3)),
    "rotation": lambda r: replace(r, base=replace(r.base, max_rotation=0.3)),
    "drive": lambda r: replace(r, base=replace(r.base, drive="differential")),
    "base frame": lambda r: replace(r, base=replace(r.base, frame="odom")),
    "soft limit": lambda r: with_arm(r, lower=r.arm[0].lower + 1e-3),
    "fewer joints": lambda r: replace(
        r, arm=r.arm[:-1], fixed_joints={**r.fixed_joints, r.arm[-1].name: 0.0}
    ),
    "torso": lambda r: replace(r, fixed_joints={**r.fixed_joints, "torso_lift_joint": 0.2}),
    "link length": lambda r: moved(r, "r_elbow_flex_joint", 1e-5),
    "axis": lambda r: with_joint(r, "r_elbow_flex_joint", axis=(0.0, 0.0, 1.0)),
    "EE frame": lambda r: replace(r, ee_frame="r_gripper_palm_link"),
}

SAME = {
    "acceleration": lambda r: replace(r, base=replace(r.base, max_acceleration=0.1)),
    "joint velocity": lambda r: with_arm(r, velocity=0.1),
    "tool tip": lambda r: replace(r, tool_tip=np.zeros(3)),
    "pose_tolerance": lambda r: replace(r, pose_tolerance=None),
    "collisions": lambda r: replace(r, ignored_collisions=frozenset()),
    "home": lambda r: replace(r, home={}),
    "left arm": lambda r: moved(r, "l_elbow_flex_joint", 0.1),
    "rounding": lambda r: moved(r, "r_elbow_flex_joint", 1e-13),
}


@pytest.mark.parametrize("change", OTHER)
def test_other_kinematics(pr2, change):
    assert fingerprint(OTHER[change](pr2)) != fingerprint(pr2)


@pytest.mark.parametrize("change", SAME)
def test_what_may_change_under_a_policy(pr2, change):
    assert fingerprint(SAME[change](pr2)) == fingerprint(pr2)


def test_the_sign_of_a_quaternion_means_nothing(pr2):
    origin = pr2.urdf.joints["r_elbow_flex_joint"].origin
    turned = np.concatenate([origin[:3], -rotation(origin).as_quat()])
    other = with_joint(pr2, "r_elbow_flex_joint", origin=turned)
    assert fingerprint(other) == fingerprint(pr2)
    half = [make_pose(np.zeros(3), rotation(np.array([0, 0, 0, 1.0, 0, 0, w]))) for w in (1e-17, 0)]
    first, second = (with_joint(pr2, "r_elbow_flex_joint", origin=pose) for pose in half)
    assert fingerprint(first) == fingerprint(second)
