import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.topics import read_topics

TOPICS = """
base: {command: /cmd, odometry: /odom}
joints:
  measured: /joint_states
  controllers:
  - {command: /arm, joints: [%s]}
"""


HSR = load_robot("hsr")
ARM = [joint.name for joint in HSR.arm]


@pytest.mark.parametrize("version", [1, 2])
def test_every_shipped_robot_has_its_names(robot, version):
    topics = read_topics(robot, version)
    assert topics.base.frame == robot.base.frame
    assert topics.gripper.open > topics.gripper.closed
    for topic in (topics.base.command, topics.base.odometry, topics.joints.measured):
        assert topic.startswith("/")
    joints = [name for one in topics.joints.controllers for name in one.joints]
    assert joints == [joint.name for joint in robot.arm]


def test_a_file_may_have_other_joint_names(tmp_path):
    path = tmp_path / "mine.yaml"
    names = "  names: {arm_lift_joint: lift}\n"
    path.write_text(TOPICS % ", ".join(["lift", *ARM[1:]]) + names)
    topics = read_topics(HSR, 2, str(path))
    assert (topics.base.command, topics.gripper) == ("/cmd", None)
    assert topics.joints.controllers[0].joints[0] == "lift"


@pytest.mark.parametrize(
    ("joints", "named"),
    [(ARM[:-1], ARM[-1]), ([*ARM, "head_pan_joint"], "head_pan"), ([*ARM, ARM[0]], ARM[0])],
)
def test_controllers_must_have_each_joint_of_the_arm_once(tmp_path, joints, named):
    path = tmp_path / "mine.yaml"
    path.write_text(TOPICS % ", ".join(joints))
    with pytest.raises(KinfeasError, match=f"mine.yaml: 'joints.controllers'.*{named}"):
        read_topics(HSR, 1, str(path))
