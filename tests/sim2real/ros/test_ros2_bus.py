"""Both ends of a robot on ROS 2, in one process and on this machine alone."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from kinfeas.core import registry, spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import BaseReading, JointReading, Orders, Readings
from kinfeas.sim2real.ros.link import RosLink
from kinfeas.sim2real.ros.names import read_topics
from kinfeas.sim2real.ros.robot import RosRobotLink
from kinfeas.sim2real.ros.ros2_bus import Ros2Bus
from kinfeas.sim2real.ros.stop import stop_base

TOPICS = """
base: {command: /cmd_vel, stamped: %s, measured_by: %s}
joints:
  measured: /joint_states
  controllers:
  - {command: /lift/joint_trajectory, joints: [torso_lift_joint]}
  - {command: /arm/joint_trajectory, joints: [%s]}
gripper: {command: /gripper/joint_trajectory, kind: trajectory, joints: [finger], open: 0.04}
"""


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "88")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    monkeypatch.setenv("CYCLONEDDS_URI", os.environ.get("CYCLONEDDS_URI", ""))
    if not os.environ["CYCLONEDDS_URI"]:
        monkeypatch.delenv("CYCLONEDDS_URI")


def eventually(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


@pytest.fixture(params=[("false", "odometry"), ("true", "tf")], ids=["plain", "stamped-tf"])
def ends(request, tmp_path):
    """Our end, the robot's end, and what each of them was handed."""
    robot = load_robot("tiago")
    path = tmp_path / "topics.yaml"
    joints = ", ".join(joint.name for joint in robot.arm[1:])
    path.write_text(TOPICS % (*request.param, joints))
    topics = read_topics(robot, 2, str(path))
    ours, theirs = RosLink(topics, Ros2Bus()), RosRobotLink(topics, Ros2Bus())
    measured, ordered = {}, {}
    ours.open(Readings(*(_into(measured, name) for name in ("base", "joints"))))
    theirs.open(Orders(*(_into(ordered, name) for name in ("drive", "move", "grip"))))
    yield ours, theirs, measured, ordered
    for end in (ours, theirs):
        end.close()
        end.close()


def _into(handed, name):
    return lambda value: handed.setdefault(name, []).append(value)


def test_commands_arrive(ends):
    ours, _, _, ordered = ends
    eventually(lambda: ours.waits_for() is None)
    eventually(lambda: ours._publishers["/gripper/joint_trajectory"].listeners())
    ours.check()
    arm = [joint.name for joint in load_robot("tiago").arm]
    positions = dict(zip(arm, np.linspace(0.1, 0.8, 8).tolist(), strict=True))

    def arrived():  # what is sent before the readers know the writers is lost
        ours.drive(np.array([0.1, -0.2, 0.3]))
        ours.move(positions, 0.25)
        ours.grip("close")
        joints = {name for way in ordered.get("move", []) for name in way.joints}
        return joints == positions.keys() and {"drive", "grip"} <= ordered.keys()

    eventually(arrived)
    np.testing.assert_array_equal(ordered["drive"][-1], [0.1, -0.2, 0.3])
    assert set(ordered["grip"]) == {"close"}
    moved = {}
    for way in ordered["move"]:
        np.testing.assert_array_equal(way.times, [0.25])
        moved |= dict(zip(way.joints, way.positions[0].tolist(), strict=True))
    assert moved == positions


def test_measurements_arrive(ends):
    ours, theirs, measured, _ = ends
    base = BaseReading(1.5, -2.0, 0.75, np.array([0.1, 0.0, -0.2]), 1e9 + 0.5)
    joints = JointReading({"torso_lift_joint": 0.25, "arm_1_joint": 1.5}, {"arm_1_joint": 0.5})

    def arrived():
        theirs.report(base, joints)
        theirs.check()
        time.sleep(0.02)
        return {"base", "joints"} <= measured.keys()

    eventually(arrived)
    place, seen = measured["base"][-1], measured["joints"][-1]
    np.testing.assert_allclose([place.x, place.y, place.yaw], [1.5, -2.0, 0.75], atol=1e-12)
    assert place.stamp == base.stamp
    if not ours.base_source.startswith("/tf"):
        np.testing.assert_array_equal(place.velocity, base.velocity)
    assert dict(seen.positions) == dict(joints.positions)
    assert dict(seen.velocities) == {"torso_lift_joint": 0.0, "arm_1_joint": 0.5}


def test_static_transforms_count_whoever_came_first(tmp_path):
    from kinfeas.sim2real.ros import ros2_messages as messages

    sender, late, heard = Ros2Bus(), Ros2Bus(), []
    sender.open("early")
    edge = messages.TransformStamped(messages.Header(frame_id="map"), "odom")
    sender.publisher("/tf_static", messages.TFMessage).publish(messages.TFMessage([edge]))
    late.open("late")
    late.subscribe("/tf_static", messages.TFMessage, heard.append, every=True)
    eventually(lambda: heard)
    assert heard[0].transforms[0].child_frame_id == "odom"
    np.testing.assert_array_equal(heard[0].transforms[0].transform.rotation.w, spatial.IDENTITY[6])
    sender.close()
    late.close()


def test_the_watchdogs_call_stops_the_base(ends):
    ours, _, _, ordered = ends
    eventually(lambda: ours.waits_for() is None)
    eventually(lambda: ours.drive(np.array([0.1, 0.0, 0.0])) or ordered.get("drive"))
    stop = stop_base(2, "/cmd_vel", stamped=ours._topics.base.stamped)
    ours.close()
    eventually(lambda: stop() or not np.any(ordered["drive"][-1]))


def test_a_robot_that_is_not_there_is_one_sentence():
    robot = load_robot("pr2")
    backend = registry.build("kinfeas.backends", "ros2", {"robot": robot, "patience": 0.2})
    with pytest.raises(
        KinfeasError, match=r"no pose of the base came from /odom within 0\.2 s; is"
    ):
        backend.reset(spatial.IDENTITY[np.newaxis], robot.home["home"][np.newaxis])
    backend.close()


def test_a_base_that_nobody_drives_is_one_sentence():
    with pytest.raises(KinfeasError, match=r"nobody listens to /nowhere within 0\.1 s"):
        stop_base(2, "/nowhere", patience=0.1)


@pytest.mark.parametrize("text", ["soon", "-1", "233", "1.5"])
def test_a_domain_that_is_none(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(KinfeasError, match=f"ROS_DOMAIN_ID must be .* 0 to 232, not '{text}'"):
        Ros2Bus().open("nobody")


BROKEN = """
import sys
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.ros.ros2_bus import Ros2Bus
if sys.argv[1] == "missing":
    sys.modules["cyclonedds"] = None
try:
    Ros2Bus().open("nobody")
except KinfeasError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("missing", "ROS 2 is reached by DDS, which is not installed: pip install 'kinfeas[ros2]'"),
        ("settings", "DDS cannot join domain 88 with CYCLONEDDS_URI=file:///nowhere.xml: "),
    ],
)
def test_what_is_missing_or_wrong_is_one_sentence(kind, said):
    env = os.environ | ({"CYCLONEDDS_URI": "file:///nowhere.xml"} if kind == "settings" else {})
    done = subprocess.run(
        [sys.executable, "-c", BROKEN, kind], capture_output=True, text=True, check=True, env=env
    )
    assert done.stdout.startswith(said)
