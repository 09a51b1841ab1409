import pytest
import yaml

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.names import read_topics

PR2 = """
base: {command: /cmd, odometry: /odom}
joints:
  measured: /joint_states
  controllers:
  - {command: /arm, joints: [%s]}
"""


@pytest.fixture(params=[1, 2])
def version(request):
    return request.param


def test_every_shipped_robot_has_its_names(robot, version):
    topics = read_topics(robot, version)
    assert topics.base.frame == robot.base.frame
    assert topics.base.measured_by == "odometry"
    assert topics.gripper is not None
    assert topics.gripper.open > topics.gripper.closed
    for topic in (topics.base.command, topics.base.odometry, topics.joints.measured):
        assert topic.startswith("/")
    joints = [name for one in topics.joints.controllers for name in one.joints]
    assert joints == [joint.name for joint in robot.arm]


@pytest.mark.parametrize(("version", "topic"), [(1, "command"), (2, "joint_trajectory")])
def test_tiagos_torso_has_a_controller_of_its_own(version, topic):
    controllers = read_topics(load_robot("tiago"), version).joints.controllers
    assert [one.command for one in controllers] == [
        f"/torso_controller/{topic}",
        f"/arm_controller/{topic}",
    ]
    assert controllers[0].joints == ("torso_lift_joint",)


def test_ones_own_file(tmp_path, version):
    robot = load_robot("pr2")
    path = tmp_path / "mine.yaml"
    path.write_text(PR2 % ", ".join(joint.name for joint in robot.arm))
    topics = read_topics(robot, version, str(path))
    assert (topics.base.command, topics.gripper) == ("/cmd", None)


def test_joints_may_have_other_names(tmp_path):
    robot = load_robot("hsr")
    arm = [joint.name for joint in robot.arm]
    data = yaml.safe_load(PR2 % ", ".join(["lift", *arm[1:]]))
    data["joints"]["names"] = {"arm_lift_joint": "lift"}
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    assert read_topics(robot, 1, str(path)).joints.controllers[0].joints[0] == "lift"


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (lambda arm: arm[:-1], "see r_wrist_roll_joint"),
        (lambda arm: [*arm, "head_pan_joint"], "see head_pan_joint"),
        (lambda arm: [*arm, arm[0]], "see r_shoulder_pan_joint"),
    ],
)
def test_controllers_share_the_arm_among_them(tmp_path, joints, said):
    robot = load_robot("pr2")
    path = tmp_path / "mine.yaml"
    path.write_text(PR2 % ", ".join(joints([joint.name for joint in robot.arm])))
    with pytest.raises(KinfeasError, match=f"mine.yaml: 'joints.controllers' must hold.*{said}"):
        read_topics(robot, 1, str(path))


@pytest.mark.parametrize(
    ("options", "said"), [((), "--set backend.topics=FILE"), (("--names FILE",), "--names FILE")]
)
def test_an_unknown_name_lists_what_there_is(options, said):
    robot = load_robot("pr2")
    known = "known are hsr, pr2, tiago, or a YAML file"
    with pytest.raises(KinfeasError, match=f"^unknown topics 'pr3'.*{known}: {said}$"):
        read_topics(robot, 2, "pr3", *options)
