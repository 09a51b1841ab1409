"""Bags of both versions of ROS, written from a log."""

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.identify.bags import read_bag
from kinfeas.sim2real.ros.topics import read_topics

DT, AGE, BEGIN = 0.02, 0.01, 1000.0
STORES = {1: Stores.ROS1_NOETIC, 2: Stores.ROS2_HUMBLE}


class Bag:
    """Writes messages of a robot that turns and drives, and moves its arm."""

    def __init__(self, version, robot, seconds=8.0):
        self.version, self.robot = version, robot
        self.store = get_typestore(STORES[version])
        self.topics = read_topics(robot, version)
        self.messages = []
        for time in np.arange(0.0, seconds, DT):
            self.command(time, 0.1, 0.5)
            self.trajectory(time, 0.1 * time)
            self.odometry(time, 0.1 * time, 0.0, 0.5 * time)
            self.joints(time, np.arange(len(robot.arm)) + 0.1 * time)

    def kind(self, name):
        return self.store.types[name]

    def stamp(self, time):
        seconds = int(BEGIN + time)
        nanoseconds = round((BEGIN + time - seconds) * 1e9)
        return self.kind("builtin_interfaces/msg/Time")(seconds, nanoseconds)

    def header(self, time, frame="odom"):
        kind = self.kind("std_msgs/msg/Header")
        own = {"stamp": self.stamp(time), "frame_id": frame}
        return kind(seq=0, **own) if self.version == 1 else kind(**own)

    def put(self, topic, name, message, time):
        self.messages.append((topic, name, message, time))

    def command(self, time, forward, turn):
        name, vector = "geometry_msgs/msg/Twist", self.kind("geometry_msgs/msg/Vector3")
        message = self.kind(name)(vector(forward, 0.0, 0.0), vector(0.0, 0.0, turn))
        self.put(self.topics.base.command, name, message, time)

    def odometry(self, time, x, y, yaw):
        name = "nav_msgs/msg/Odometry"
        point, quaternion = (self.kind(f"geometry_msgs/msg/{k}") for k in ("Point", "Quaternion"))
        pose = self.kind("geometry_msgs/msg/Pose")(
            point(x, y, 0.0), quaternion(0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0))
        )
        vector = self.kind("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
        twist = self.kind("geometry_msgs/msg/Twist")(vector, vector)
        message = self.kind(name)(
            self.header(time - AGE), self.topics.base.frame,
            self.kind("geometry_msgs/msg/PoseWithCovariance")(pose, np.zeros(36)),
            self.kind("geometry_msgs/msg/TwistWithCovariance")(twist, np.zeros(36)),
        )  # fmt: skip
        self.put(self.topics.base.odometry, name, message, time)

    def joints(self, time, positions):
        name, names = "sensor_msgs/msg/JointState", [joint.name for joint in self.robot.arm]
        message = self.kind(name)(
            self.header(time - AGE), names, np.array(positions, dtype=float),
            np.empty(0), np.empty(0),
        )  # fmt: skip
        self.put(self.topics.joints.measured, name, message, time)

    def trajectory(self, time, position):
        name = "trajectory_msgs/msg/JointTrajectory"
        for controller in self.topics.joints.controllers:
            duration = self.kind("builtin_interfaces/msg/Duration")(0, 100_000_000)
            point = self.kind("trajectory_msgs/msg/JointTrajectoryPoint")(
                np.full(len(controller.joints), position), np.empty(0), np.empty(0), np.empty(0),
                duration,
            )  # fmt: skip
            message = self.kind(name)(self.header(time), list(controller.joints), [point])
            self.put(controller.command, name, message, time)

    def write(self, path):
        make = rosbag1.Writer(path) if self.version == 1 else rosbag2.Writer(path, version=9)
        with make as writer:
            connections = {}
            for topic, name, message, time in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=self.store)
                dump = self.store.serialize_ros1 if self.version == 1 else self.store.serialize_cdr
                nanoseconds = round((BEGIN + time) * 1e9)
                writer.write(connections[topic], nanoseconds, dump(message, name))
        return path


@pytest.fixture(params=[1, 2])
def bag(request, hsr):
    return Bag(request.param, hsr)


@pytest.fixture
def path(bag, tmp_path):
    return tmp_path / ("run.bag" if bag.version == 1 else "run")


def test_commands_and_measurements_are_read_with_their_times(bag, path, hsr):
    log = read_bag(bag.write(path), hsr)
    assert log.dt == pytest.approx(DT, abs=1e-6)
    np.testing.assert_allclose(log.ages, AGE, atol=1e-6)
    # Commands are in world axes, and the heading is half a radian a second.
    row = 200
    heading = 0.5 * (row * DT + AGE)
    expected = [0.1 * np.cos(heading), 0.1 * np.sin(heading), 0.5]
    np.testing.assert_allclose(log.twists[row], expected, atol=2e-3)
    np.testing.assert_allclose(log.base[:, 2], 0.5 * (log.base_times + AGE), atol=1e-6)
    np.testing.assert_allclose(log.joints[:, 1], 1.0 + 0.1 * (log.joint_times + AGE), atol=1e-6)
    np.testing.assert_allclose(log.targets[row], 0.1 * row * DT, atol=1e-6)


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda bag: bag.odometry(8.0, np.nan, 0.0, 0.0), "not finite"),
        (lambda bag: bag.joints(8.0, np.full(5, np.inf)), "not finite"),
        (lambda bag: bag.odometry(2.0, 0.0, 0.0, 0.0), "out of order"),
        (lambda bag: bag.messages.__delitem__(slice(100, None)), "shorter"),
        (lambda bag: bag.messages.__setitem__(
            slice(None), [each for each in bag.messages if "Joint" not in each[1]]), "has no"),
    ],
)  # fmt: skip
def test_broken_bags_raise(bag, path, hsr, spoil, named):
    spoil(bag)
    if named == "out of order":  # the last message is recorded late
        *rest, _ = bag.messages[-1]
        bag.messages[-1] = (*rest, 8.0)
    with pytest.raises(KinfeasError, match=named):
        read_bag(bag.write(path), hsr)


def test_other_files_are_no_bags(tmp_path, hsr):
    path = tmp_path / "run.bag"
    path.write_bytes(b"not a bag")
    for each in (path, tmp_path / "none", tmp_path):
        with pytest.raises(KinfeasError, match=each.name):
            read_bag(each, hsr)
