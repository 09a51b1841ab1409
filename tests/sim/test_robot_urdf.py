import numpy as np

from kinfeas.robots.urdf import parse_urdf
from kinfeas.sim.moving_joints import moving_joints
from kinfeas.sim.robot_urdf import PLANAR_JOINTS, physics_urdf


def test_is_the_robot_on_planar_joints(robot, tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(physics_urdf(robot).replace('lower="0" upper="-1"', 'lower="-9" upper="9"'))
    urdf = parse_urdf(path)
    moving = [name for name, joint in urdf.joints.items() if joint.moves]
    assert moving[:3] == list(PLANAR_JOINTS)
    assert set(moving[3:]) == moving_joints(robot)
    assert urdf.joints[PLANAR_JOINTS[-1]].child == robot.urdf.root
    assert not any(joint.mimic for joint in urdf.joints.values())


def test_joints_that_stand_still_stand_where_the_robot_holds_them(robot, tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(physics_urdf(robot).replace('lower="0" upper="-1"', 'lower="-9" upper="9"'))
    fixed = parse_urdf(path).joints
    for name, position in robot.fixed_joints.items():
        if not fixed[name].moves:
            expected = robot.urdf.joints[name].pose_at(position)
            np.testing.assert_allclose(fixed[name].origin, expected, atol=1e-12)
