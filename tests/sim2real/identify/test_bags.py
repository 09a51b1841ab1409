"""Bags of both versions of ROS, of what both ends of a link send."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.identify.bags import read_bag
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.ros.backend import RosLink, RosRobotLink
from kinfeas.sim2real.ros.ros2 import MESSAGES
from kinfeas.sim2real.ros.topics import read_topics

DT, AGE, BEGIN = 0.02, 0.01, 1000.0
ROS1, ROS2 = (get_typestore(store) for store in (Stores.ROS1_NOETIC, Stores.ROS2_HUMBLE))
TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
ROS1.register(get_types_from_msg(TRANSFORMS, "tf2_msgs/msg/TFMessage"))


class Bag:
    """The messages of a robot that turns and drives, and moves its arm."""

    def __init__(self, version, robot, seconds=8.0):
        self.version, self.messages = version, []
        self.arm = [joint.name for joint in robot.arm]
        topics, bus = read_topics(robot, version), Mock(messages=MESSAGES, publisher=self.publisher)
        self.ours, self.theirs = RosLink(topics, bus), RosRobotLink(topics, bus)
        for end in (self.ours, self.theirs):
            end.open(Mock())
        for self.time in np.arange(0.0, seconds, DT):
            self.ours.drive(np.array([0.1, 0.0, 0.5]))
            self.ours.move(dict.fromkeys(self.arm, 0.1 * self.time), 0.1)
            self.report(self.time)
        self.time = seconds

    def publisher(self, topic, kind):
        package, _, _, name = kind.__idl_typename__.split("::")
        name = f"{package}/msg/{name[:-1]}"
        return Mock(publish=lambda message: self.messages.append((topic, name, message, self.time)))

    def report(self, time, x=0.0, joints=0.0):
        """Send a measurement of a time, with `x` and `joints` added to it."""
        positions = np.arange(len(self.arm)) + 0.1 * time + joints
        base = BaseReading(0.1 * time + x, 0.0, 0.5 * time, stamp=BEGIN + time - AGE)
        joints = JointReading(dict(zip(self.arm, positions.tolist(), strict=True)))
        self.theirs.report(base, joints, None)

    def write(self, path):
        make = rosbag1.Writer(path) if self.version == 1 else rosbag2.Writer(path, version=9)
        store = ROS1 if self.version == 1 else ROS2
        with make as writer:
            connections = {}
            for topic, name, message, time in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=store)
                content = message.serialize(use_version_2=False)
                if self.version == 1:
                    content = ROS2.cdr_to_ros1(content, name)
                writer.write(connections[topic], round((BEGIN + time) * 1e9), content)
        return path


def repeat(bag, times):
    """Send measurements of other poses at times."""
    for bag.time in times:
        bag.report(bag.time, x=0.5, joints=0.5)


@pytest.fixture(scope="session", params=["odometry", "tf"])
def robot(request, hsr, tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    for version in (1, 2):
        text = (hsr.folder / f"ros{version}.yaml").read_text()
        changed = text.replace("base:\n", f"base:\n  measured_by: {request.param}\n")
        (folder / f"ros{version}.yaml").write_text(changed)
    return replace(hsr, folder=folder)


@pytest.fixture(params=[1, 2])
def bag(request, robot):
    return Bag(request.param, robot)


@pytest.fixture
def path(bag, tmp_path):
    return tmp_path / ("run.bag" if bag.version == 1 else "run")


def test_commands_and_measurements_are_read_with_their_times(bag, path, robot):
    log = read_bag(bag.write(path), robot)
    assert log.dt == pytest.approx(DT, abs=1e-6)
    np.testing.assert_allclose(log.ages, AGE, atol=1e-6)
    assert log.arm_seconds == pytest.approx(0.1)
    # Commands are in world axes, and the heading is half a radian a second.
    row = 200
    heading = 0.5 * (row * DT + AGE)
    expected = [0.1 * np.cos(heading), 0.1 * np.sin(heading), 0.5]
    np.testing.assert_allclose(log.twists[row], expected, atol=2e-3)
    np.testing.assert_allclose(log.base[:, 2], 0.5 * (log.base_times + AGE), atol=1e-6)
    np.testing.assert_allclose(log.joints[:, 1], 1.0 + 0.1 * (log.joint_times + AGE), atol=1e-6)
    np.testing.assert_allclose(log.targets[row], 0.1 * row * DT, atol=1e-6)


@pytest.mark.parametrize(("spoil", "named"), [
    (lambda bag: bag.report(8.0, x=np.nan), "not finite"),
    (lambda bag: bag.report(8.0, joints=np.inf), "not finite"),
    (lambda bag: bag.report(2.0), "out of order"),
    (lambda bag: repeat(bag, [28.0]), "clock goes from 7.980 s to 28"),
    (lambda bag: repeat(bag, np.arange(2.0, 4.0, DT) + 0.3 * DT), "set back"),
    (lambda bag: bag.messages.__delitem__(slice(100, None)), "shorter"),
    (lambda bag: bag.messages.__setitem__(
        slice(None), [each for each in bag.messages if "Joint" not in each[1]]), "has no"),
    (lambda bag: bag.messages.__setitem__(slice(None), [
        each for each in bag.messages if "Twist" not in each[1] or not each[3]
    ]), "velocity command in /"),
])  # fmt: skip
def test_broken_bags_raise(bag, path, robot, spoil, named):
    spoil(bag)
    with pytest.raises(KinfeasError, match=named):
        read_bag(bag.write(path), robot)


def test_invalid_trajectories_are_left_out(bag, path, robot):
    topic, name, message, _ = next(each for each in bag.messages if "Trajectory" in each[1])
    point = replace(message.points[0], positions=[*message.points[0].positions, 1.0])
    bag.messages.append((topic, name, replace(message, points=[point]), bag.time))
    assert read_bag(bag.write(path), robot).targets.max() < 0.1 * bag.time


def test_joint_states_without_all_positions_are_left_out(bag, path, robot):
    topic, name, message, _ = next(each for each in bag.messages if "JointState" in each[1])
    short = replace(message, position=message.position[:1])
    bag.messages.insert(len(bag.messages) // 2, (topic, name, short, bag.time / 2.0))
    log = read_bag(bag.write(path), robot)
    np.testing.assert_allclose(log.joints[:, 1], 1.0 + 0.1 * (log.joint_times + AGE), atol=1e-6)


def test_trajectories_of_one_controller_do_not_end_those_of_others(tmp_path):
    robot = load_robot("tiago")
    bag = Bag(2, robot)
    paths = [each for each in bag.messages if "Trajectory" in each[1]]
    bag.messages = [each for each in bag.messages if each not in paths or each[3] < 4.0]
    for k, topic in enumerate(dict.fromkeys(each[0] for each in paths)):
        _, name, message, _ = next(each for each in paths if each[0] == topic)
        (point,) = message.points
        ends = [(1, 0.5), (2, 1.0)]
        points = [
            replace(
                point, positions=[end] * len(point.positions),
                time_from_start=replace(point.time_from_start, sec=sec, nanosec=0),
            )
            for sec, end in ends
        ]  # fmt: skip
        bag.messages.append((topic, name, replace(message, points=points), 4.0 + 0.001 * k))
    targets = read_bag(bag.write(tmp_path / "run"), robot).targets
    np.testing.assert_allclose(targets[round(5.0 / DT)], 0.5, atol=0.02)
    np.testing.assert_allclose(targets[round(7.0 / DT)], 1.0, atol=1e-9)


def test_trajectories_longer_than_the_recording_end_with_it(bag, path, robot):
    topic, name, message, _ = next(each for each in bag.messages if "Trajectory" in each[1])
    (point,) = message.points
    points = [
        replace(point, time_from_start=replace(point.time_from_start, sec=sec, nanosec=0))
        for sec in (1, 2_000_000_000)
    ]
    bag.messages.append((topic, name, replace(message, points=points), bag.time - DT))
    assert len(read_bag(bag.write(path), robot).targets) * DT == pytest.approx(bag.time, abs=1.0)


@pytest.mark.parametrize(("file", "old", "new"), [
    ("metadata.yaml", b"topics", b"\xff\xfe"),
    ("run.db3", b"TwistWithCovariance", b"TwinkWithCovariance"),
    ("run.db3", b"SQLite format 3", b"SQLite format 9"),
])  # fmt: skip
def test_bags_with_broken_bytes_raise(tmp_path, hsr, file, old, new):
    run = Bag(2, hsr, seconds=0.1).write(tmp_path / "run")
    (run / file).write_bytes((run / file).read_bytes().replace(old, new))
    with pytest.raises(KinfeasError, match="run: no bag that can be read"):
        read_bag(run, hsr)


def test_other_files_are_no_bags(tmp_path, hsr):
    path = tmp_path / "run.bag"
    path.write_bytes(b"not a bag")
    for each, named in ((path, ""), (tmp_path / "none", ""), (tmp_path, ".*metadata.yaml")):
        with pytest.raises(KinfeasError, match=each.name + named):
            read_bag(each, hsr)
