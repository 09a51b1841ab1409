import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.backend import SCAN_BEAMS
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link.scans import CostmapReading, laser_ranges
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.ros1 import ros1_message_classes
from kinfeas.sim2real.ros.ros2 import MESSAGES as ROS2
from kinfeas.sim2real.ros.topics import CostmapTopic, GripperTopics, ScanTopic, read_topics
from tests.sim2real.ros_processes import needs_ros1

REFERENCE = get_typestore(Stores.ROS2_HUMBLE)


@pytest.fixture(params=[pytest.param(1, marks=needs_ros1), 2])
def version(request):
    return request.param


@pytest.fixture
def messages(version):
    return ros1_message_classes() if version == 1 else ROS2


def filled(kind, name, rng):
    """Return a message, or the value of one of its fields, with random numbers."""
    if dataclasses.is_dataclass(kind):
        values = {
            field.name: filled(type(getattr(kind(), field.name)), field.name, rng)
            for field in dataclasses.fields(kind)
        }
        return kind(**values)
    if kind is list:
        items = {"points": ROS2.JointTrajectoryPoint, "transforms": ROS2.TransformStamped}
        items |= {"name": str, "joint_names": str, "data": int, "poses": ROS2.PoseStamped}
        count = 36 if name == "covariance" else 3
        return [filled(items.get(name, float), "", rng) for _ in range(count)]
    if kind is float:
        return float(np.float32(rng.normal()))
    return kind(rng.integers(100))


def plain(value):
    """Return a message as plain lists, field by field."""
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value) if field.name != "__msgtype__"]
        return [plain(getattr(value, name)) for name in names]
    return [plain(item) for item in value] if isinstance(value, list | np.ndarray) else value


@pytest.mark.parametrize("kind", vars(ROS2).values())
def test_messages_of_ros_2_have_the_bytes_of_another_implementation(kind):
    package, _, _, short = kind.__idl_typename__.split("::")
    name = f"{package}/msg/{short.removesuffix('_')}"
    fields = [field for field, _ in REFERENCE.get_msgdef(name).fields]
    assert [field.name for field in dataclasses.fields(kind)] == fields
    rng = np.random.default_rng(5)
    for message in (kind(), *(filled(kind, "", rng) for _ in range(5))):
        data = message.serialize(use_version_2=False)
        reference = REFERENCE.deserialize_cdr(data, name)
        assert plain(reference) == plain(message)
        # Some senders fill up the last word, some do not.
        again = bytes(REFERENCE.serialize_cdr(reference, name))
        assert again.rstrip(b"\0") == data.rstrip(b"\0")
        assert plain(kind.deserialize(again)) == plain(message)
    if package == "builtin_interfaces":
        for seconds in (0.0, 1.9999999999, 1.7e9 + 0.125, -0.25, -3.0):
            made = kind.from_sec(seconds)
            assert 0 <= made.nanosec < 10**9
            assert made.to_sec() == pytest.approx(seconds, abs=1e-9)


@pytest.mark.parametrize("stamp", [None, 12.5])
def test_commands_survive_a_round_trip(messages, version, stamp):
    command = ros_messages.drive_command(messages, np.array([0.1, -0.2, 0.3]), stamp)
    np.testing.assert_array_equal(ros_messages.velocity(command), [0.1, -0.2, 0.3])
    if stamp is not None:
        assert command.header.stamp.to_sec() == stamp
    path = ros_messages.path(ros_messages.trajectory(messages, {"a": 0.5, "b": -1.0}, 0.25))
    assert (path.joints, path.times.tolist()) == (("a", "b"), [0.25])
    np.testing.assert_array_equal(path.positions, [[0.5, -1.0]])
    mirrored = GripperTopics("/hand", "trajectory", (0.04, -0.04), joints=("l", "r"))
    for gripper in (read_topics(load_robot("hsr"), version).gripper, mirrored):
        for grip in ("open", "close"):
            message = ros_messages.gripper_command(messages, gripper, grip)
            assert ros_messages.from_gripper(gripper, message) == grip
    last = ros_messages.trajectory(messages, {"r": -0.03}, 0.25)
    assert ros_messages.from_gripper(mirrored, last) == "open"


def test_an_invalid_trajectory_is_none(messages):
    def path(**positions):
        return ros_messages.trajectory(messages, positions, 0.25)

    empty, short, twice = path(a=0.5), path(a=0.5, b=1.0), path(a=0.5)
    empty.points = []
    short.points[0].positions = [1.0]
    twice.points = twice.points * 2
    for message in (empty, short, twice, path(a=np.nan), path(a=1e308)):
        assert ros_messages.path(message) is None


def test_an_invalid_gripper_command_is_none():
    command = SimpleNamespace(position=np.nan)
    assert ros_messages.from_gripper(GripperTopics("/hand", "pr2", 0.09), command) is None


def test_joint_states_may_lack_velocities_but_not_positions(messages):
    state = messages.JointState()
    state.name, state.effort = ["a", "b"], [1.0, 2.0]
    assert ros_messages.from_joint_state(state) is None
    state.position = [1.0, 2.0]
    reading = ros_messages.from_joint_state(state)
    assert reading.positions == {"a": 1.0, "b": 2.0}
    assert reading.velocities == {}
    assert reading.stamp is None


@pytest.mark.parametrize("upside_down", [False, True])
def test_lasers_are_read_from_their_mount(messages, upside_down):
    ranges = np.linspace(0.5, 3.0, SCAN_BEAMS)
    message = ros_messages.laser_scan(messages, ranges)
    message.header.frame_id = "/base"
    topic = ScanTopic("/scan", 0.2, 0.1, 0.5, upside_down)
    reading = ros_messages.from_laser_scan(topic, "base", message)
    np.testing.assert_allclose(laser_ranges(reading), ranges, atol=1e-6)
    assert reading.stamp is None
    message.header.frame_id = "laser"
    message.header.stamp = messages.Time.from_sec(5.0)
    mounted = ros_messages.from_laser_scan(topic, "base", message)
    assert (mounted.mount, mounted.stamp) == ((0.2, 0.1, 0.5), 5.0)
    assert (mounted.angle_increment < 0.0) == upside_down


def test_costmaps_survive_a_round_trip_into_another_frame(messages):
    cells = np.arange(-1, 5, dtype=np.int8).reshape(2, 3)
    message = ros_messages.occupancy_grid(messages, CostmapReading(cells, 0.25, (1.0, 2.0, 0.0)))
    frame = np.array(pose(3.0, 0.0, np.pi / 2))
    reading = ros_messages.from_costmap(CostmapTopic("/map", 65), frame, message)
    np.testing.assert_array_equal(reading.cells, cells)
    assert (reading.resolution, reading.occupied) == (0.25, 65)
    np.testing.assert_allclose(reading.origin, [1.0, 1.0, np.pi / 2])
    for width, resolution in ((4, 0.25), (3, 1e-6)):  # the second would fill the memory
        message.info.width, message.info.resolution = width, resolution
        assert ros_messages.from_costmap(CostmapTopic("/map"), frame, message) is None


def transforms(*edges):
    """Return a TFMessage of (parent, child, pose, stamp)."""
    made = []
    for parent, child, pose, stamp in edges:
        header = ROS2.Header(ROS2.Time.from_sec(stamp), parent)
        transform = ROS2.Transform(ROS2.Vector3(*pose[:3]), ROS2.Quaternion(*pose[3:]))
        made.append(ROS2.TransformStamped(header, child, transform))
    return ROS2.TFMessage(made)


def pose(x=0.0, y=0.0, yaw=0.0):
    return spatial.planar_pose(*np.array([x, y, yaw])).tolist()


@pytest.fixture
def tree(time):
    return ros_messages.TfTree("map", "/base", now=time.clock.monotonic)


def test_tf_composes_the_transforms_to_the_world(tree):
    map_odom, odom_base = pose(1.0, -2.0, 2.0), pose(0.5, 0.25, 1.5)
    tree.take(transforms(("/odom", "base", odom_base, 7.0)))
    assert tree.reading() is None
    tree.take(transforms(("map", "odom", map_odom, 5.0), ("base", "base_link", pose(), 7.0)))
    reading = tree.reading()
    expected = spatial.compose(np.array(map_odom), np.array(odom_base))
    np.testing.assert_allclose([reading.x, reading.y], expected[:2])
    assert reading.yaw == pytest.approx(float(spatial.yaw(expected)))
    assert (reading.stamp, reading.velocity) == (7.0, None)
    np.testing.assert_allclose(tree.pose("odom"), map_odom, atol=1e-12)
    np.testing.assert_allclose(tree.pose("/map"), spatial.IDENTITY, atol=1e-12)
    assert tree.pose("camera") is None


def test_tf_is_as_old_as_its_oldest_transform(tree, time):
    tree.take(transforms(("map", "odom", pose(), 1.0)))
    time.passes(3.0)
    tree.take(transforms(("odom", "base", pose(), 4.0)))
    assert tree.reading().age == pytest.approx(3.0)
    tree.take(transforms(("map", "odom", pose(), 4.0)))
    assert tree.reading().age == 0.0
    time.passes(2.0)
    tree.take(transforms(("odom", "base", pose(), 4.0)))  # sent again
    tree.take(transforms(("map", "odom", pose(), 6.0)))
    assert tree.reading().age == pytest.approx(2.0)


def test_static_transforms_do_not_age_and_a_cycle_has_no_pose(tree, time):
    tree.take(transforms(("map", "odom", pose(), 0.0)), static=True)
    time.passes(50.0)
    tree.take(transforms(("odom", "base", pose(), 0.0)))
    assert (tree.reading().age, tree.reading().stamp) == (0.0, None)
    tree.take(transforms(("base", "odom", pose(), 1.0)))
    assert tree.reading() is None


def test_a_planar_pose_has_no_tilt_and_needs_a_unit_quaternion():
    tilted = spatial.rotation(np.array(pose(yaw=0.7))) * Rotation.from_euler("x", 0.02)
    x, y, yaw = ros_messages.planar(spatial.make_pose(np.array([1.0, 2.0, 0.3]), tilted))
    assert (x, y) == (1.0, 2.0)
    assert yaw == pytest.approx(0.7)
    for quaternion in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.5), (np.nan,) * 4):
        assert np.isnan(ros_messages.planar(np.array([1.0, 2.0, 0.0, *quaternion]))).all()


@pytest.mark.parametrize(("w", "length"), [(0.0, "length 0,"), (1.04, "length 1.04"), (1.0, "")])
def test_an_odometry_without_unit_quaternion_has_its_length(messages, w, length):
    odometry = messages.Odometry()
    odometry.pose.pose.orientation.w = w
    fault = ros_messages.from_odometry(odometry).fault
    assert length in fault if length else not fault


TOPICS = """
base: {command: /cmd, odometry: /odom}
joints:
  measured: /joint_states
  names: {arm_lift_joint: lift}
  controllers:
  - {command: /arm, joints: [%s]}
"""
HSR = load_robot("hsr")
ARM = ["lift", *(joint.name for joint in HSR.arm[1:])]


@pytest.mark.parametrize("version", [1, 2])
def test_every_shipped_robot_has_its_names(robot, version):
    topics = read_topics(robot, version)
    assert topics.base.frame == robot.base.frame
    assert topics.gripper.open > topics.gripper.closed
    for topic in (topics.base.command, topics.base.odometry, topics.joints.measured):
        assert topic.startswith("/")
    joints = [name for controller in topics.joints.controllers for name in controller.joints]
    assert joints == [joint.name for joint in robot.arm]


@pytest.mark.parametrize(("joints", "gripper", "named"), [
    (ARM[:-1], "", f"mine.yaml: 'joints.controllers'.*{ARM[-1]}"),
    ([*ARM, "head_pan_joint"], "", "'joints.controllers'.*head_pan"),
    ([*ARM, ARM[0]], "", f"'joints.controllers'.*{ARM[0]}"),
    (ARM, "kind: trajectory, open: 1", "gripper.*joints"),
    (ARM, "kind: trajectory, joints: [hand]", "gripper.*open"),
    (ARM, "kind: trajectory, joints: [hand], open: [1, 2]", "gripper.*open"),
])  # fmt: skip
def test_invalid_topics_are_errors_with_their_keys(tmp_path, joints, gripper, named):
    path = tmp_path / "mine.yaml"
    path.write_text(TOPICS % ", ".join(ARM))
    assert read_topics(HSR, 2, str(path)).joints.controllers[0].joints == tuple(ARM)
    extra = f"gripper: {{command: /hand, {gripper}}}" if gripper else ""
    path.write_text(TOPICS % ", ".join(joints) + extra)
    with pytest.raises(KinfeasError, match=named):
        read_topics(HSR, 2, str(path))
