"""Messages of both versions of ROS say the same to a link, and go over the wire as ROS has them."""

import dataclasses

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros import ros2_messages
from kinfeas.sim2real.ros.names import read_topics
from kinfeas.sim2real.ros.ros1_bus import ros1_message_classes
from kinfeas.sim2real.ros.ros2_bus import ros2_message_classes
from tests.sim2real.ros_processes import needs_ros1

JUDGE = get_typestore(Stores.ROS2_HUMBLE)
KINDS = [one for one in vars(ros2_messages).values() if hasattr(one, "__idl_typename__")]
OWN = [one for one in KINDS if one.__module__ == ros2_messages.__name__]


@pytest.fixture(params=[pytest.param(1, marks=needs_ros1), 2])
def version(request):
    return request.param


@pytest.fixture
def messages(version):
    return ros1_message_classes() if version == 1 else ros2_message_classes()


def named(kind):
    """Return what ROS calls a message: `std_msgs/msg/Header`."""
    return kind.__idl_typename__.replace("::dds_::", "/").replace("::", "/").removesuffix("_")


def filled(kind, rng):
    """Return a message with something in each of its fields."""
    message = kind()
    for one in dataclasses.fields(kind):
        value = getattr(message, one.name)
        if dataclasses.is_dataclass(value):
            new = filled(type(value), rng)
        elif isinstance(value, str):
            new = "x" * int(rng.integers(1, 9))
        elif isinstance(value, int):
            new = int(rng.integers(2**31))
        elif isinstance(value, float):
            new = float(rng.normal())
        else:
            new = [_entry(one.name, rng) for _ in range(len(value) or 3)]
        setattr(message, one.name, new)
    return message


def _entry(name, rng):
    inner = {
        "points": ros2_messages.JointTrajectoryPoint, "transforms": ros2_messages.TransformStamped
    }  # fmt: skip
    if name in inner:
        return filled(inner[name], rng)
    return f"joint{rng.integers(100)}" if name in ("name", "joint_names") else float(rng.normal())


def plain(value):
    """Return a message as plain lists, field by field."""
    if dataclasses.is_dataclass(value):
        names = [one.name for one in dataclasses.fields(value) if one.name != "__msgtype__"]
        return [plain(getattr(value, name)) for name in names]
    return [plain(one) for one in value] if isinstance(value, list | np.ndarray) else value


@pytest.mark.parametrize("kind", OWN, ids=named)
def test_a_message_of_ros_2_has_the_bytes_that_another_program_reads(kind):
    fields = [name for name, _ in JUDGE.get_msgdef(named(kind)).fields]
    assert [one.name for one in dataclasses.fields(kind)] == fields
    rng = np.random.default_rng(5)
    for message in (kind(), *(filled(kind, rng) for _ in range(5))):
        data = message.serialize(use_version_2=False)
        theirs = JUDGE.deserialize_cdr(data, named(kind))
        assert plain(theirs) == plain(message)
        # Some senders fill up the last word, some do not.
        again = bytes(JUDGE.serialize_cdr(theirs, named(kind)))
        assert again.rstrip(b"\0") == data.rstrip(b"\0")
        assert plain(kind.deserialize(again)) == plain(message)


@pytest.mark.parametrize("kind", [ros2_messages.Time, ros2_messages.Duration])
@pytest.mark.parametrize("seconds", [0.0, 0.25, 1.9999999999, 1.7e9 + 0.125, -0.25, -3.0])
def test_seconds_come_back(kind, seconds):
    made = kind.from_sec(seconds)
    assert isinstance(made, kind)
    assert 0 <= made.nanosec < 10**9
    assert made.to_sec() == pytest.approx(seconds, abs=1e-9)


@needs_ros1
def test_pr2s_gripper_needs_no_package():
    messages = ros1_message_classes()
    gripper = read_topics(load_robot("pr2"), 1).gripper
    kind = ros_messages.gripper_type(messages, gripper)
    assert kind._md5sum == "680acaff79486f017132a7f198d40f08"
    opened = ros_messages.gripper_command(messages, gripper, "open")
    assert opened.position == gripper.open
    assert ros_messages.gripper_command(messages, gripper, "close").max_effort == 100.0


def test_a_gripper_is_understood_at_the_other_end(messages, version, robot):
    gripper = read_topics(robot, version).gripper
    for grip in ("open", "close"):
        message = ros_messages.gripper_command(messages, gripper, grip)
        assert ros_messages.from_gripper(gripper, message) == grip


def test_a_target_is_understood_at_the_other_end(messages):
    way = ros_messages.path(ros_messages.trajectory(messages, {"a": 0.5, "b": -1.0}, 0.25))
    assert way.joints == ("a", "b")
    np.testing.assert_array_equal(way.times, [0.25])
    np.testing.assert_array_equal(way.positions, [[0.5, -1.0]])


@pytest.mark.parametrize("stamp", [None, 12.5])
def test_a_velocity_is_understood_at_the_other_end(messages, stamp):
    command = ros_messages.drive_command(messages, np.array([0.1, -0.2, 0.3]), stamp)
    np.testing.assert_array_equal(ros_messages.velocity(command), [0.1, -0.2, 0.3])
    assert isinstance(command, messages.Twist if stamp is None else messages.TwistStamped)
    if stamp is not None:
        assert command.header.stamp.to_sec() == stamp


def test_a_broken_way_is_none(messages):
    def way(**positions):
        return ros_messages.trajectory(messages, positions, 0.25)

    empty, short, twice = way(a=0.5), way(a=0.5, b=1.0), way(a=0.5)
    empty.points = []
    short.points[0].positions = [1.0]
    twice.points = twice.points * 2
    for message in (empty, short, twice, way(a=np.nan)):
        assert ros_messages.path(message) is None


def test_joint_states_may_lack_velocities_but_not_positions(messages):
    state = messages.JointState()
    state.name, state.effort = ["a", "b"], [1.0, 2.0]
    assert ros_messages.from_joint_state(state) is None
    state.position = [1.0, 2.0]
    reading = ros_messages.from_joint_state(state)
    assert reading.positions == {"a": 1.0, "b": 2.0}
    assert reading.velocities == {}
    assert reading.stamp is None


def test_pr2s_own_gripper_message_is_refused_in_ros_2(tmp_path):
    robot = load_robot("pr2")
    path = tmp_path / "topics.yaml"
    path.write_text(
        "base: {command: /cmd_vel}\ngripper: {command: /gripper, kind: pr2}\njoints:\n"
        "  measured: /joint_states\n  controllers:\n  - command: /arm\n    joints: ["
        + ", ".join(joint.name for joint in robot.arm)
        + "]\n"
    )
    assert read_topics(robot, 1, str(path)).gripper.kind == "pr2"
    with pytest.raises(KinfeasError, match=r"topics\.yaml: 'gripper\.kind' must be trajectory in"):
        read_topics(robot, 2, str(path))
