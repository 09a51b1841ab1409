from functools import reduce

import numpy as np
import pytest

from kinfeas.backends.pybullet.robot_body import PLANAR_JOINTS, moving_joints, physics_urdf
from kinfeas.core.spatial import IDENTITY, compose
from kinfeas.robots.urdf import parse_urdf


@pytest.fixture
def urdf(robot, tmp_path):
    text, _ = physics_urdf(robot)
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace('lower="0" upper="-1"', 'lower="-9" upper="9"'))
    return parse_urdf(path)


def test_is_the_robot_on_planar_joints(robot, urdf):
    moving = [name for name, joint in urdf.joints.items() if joint.moves]
    assert moving[:3] == list(PLANAR_JOINTS)
    assert set(moving[3:]) == moving_joints(robot)
    assert urdf.joints[PLANAR_JOINTS[-1]].child == robot.urdf.root
    assert not any(joint.mimic for joint in urdf.joints.values())


def test_nothing_stands_still_but_the_end_effector_in_its_link(robot, urdf):
    fixed = {joint.child for joint in urdf.joints.values() if not joint.moves}
    assert fixed <= {robot.ee_frame}


def test_joints_that_stand_still_stand_where_the_robot_holds_them(robot, urdf):
    moving = moving_joints(robot)
    still = {name: at for name, at in robot.fixed_joints.items() if name not in moving}
    for link in (*(robot.urdf.joints[name].child for name in moving), robot.ee_frame):
        expected = _pose(robot.urdf, link, still)
        np.testing.assert_allclose(_pose(urdf, link, {}), expected, atol=1e-9)


def _pose(urdf, link, positions):
    """Return where a link is, all joints without a position at 0."""
    poses = [joint.pose_at(positions.get(joint.name, 0.0)) for joint in urdf.path_to(link)]
    return reduce(compose, poses, IDENTITY)
