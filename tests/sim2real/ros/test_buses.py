import select
import socket
import threading
import time
from contextlib import closing
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.control.targets import StreamProgress
from kinfeas.core import spatial
from kinfeas.core.backend import SCAN_BEAMS
from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import BaseReading, JointReading, Orders, Readings
from kinfeas.sim2real.link.scans import LaserReading, costmap_ranges, laser_ranges
from kinfeas.sim2real.ros import bus as ros_bus
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.backend import RosLink, RosRobotLink
from kinfeas.sim2real.ros.bus import stop_base
from kinfeas.sim2real.ros.ros1 import MasterWatch
from kinfeas.sim2real.ros.ros2 import MESSAGES, Ros2Bus
from kinfeas.sim2real.ros.topics import read_topics
from kinfeas.sim2real.servo.controller import TargetController
from kinfeas.sim2real.servo.ros import Ros2Source
from tests.builders import at, wait

pytestmark = pytest.mark.usefixtures("domain")

TOPICS = """
base: {command: /cmd_vel, stamped: %s, measured_by: %s}
joints:
  measured: /joint_states
  controllers:
  - {command: /lift/joint_trajectory, joints: [torso_lift_joint]}
  - {command: /arm/joint_trajectory, joints: [%s]}
scan: {topic: /scan, x: 0.2}
costmap: {topic: /local_costmap/costmap}
gripper: {command: /gripper/joint_trajectory, kind: trajectory, joints: [finger], open: 0.04}
"""
TIAGO = load_robot("tiago")
ARM = [joint.name for joint in TIAGO.arm]


@pytest.fixture(params=[("false", "odometry"), ("true", "tf")], ids=["plain", "stamped-tf"])
def ends(request, tmp_path):
    """Both ends, and what each of them received."""
    path = tmp_path / "topics.yaml"
    path.write_text(TOPICS % (*request.param, ", ".join(ARM[1:])))
    topics = read_topics(TIAGO, 2, str(path))
    ours, theirs = RosLink(topics, Ros2Bus()), RosRobotLink(topics, Ros2Bus())
    measured = {"base": [], "joints": [], "scan": []}
    ordered = {"drive": [], "move": [], "grip": []}
    ours.open(Readings(*(into.append for into in measured.values())))
    theirs.open(Orders(*(into.append for into in ordered.values())))
    yield ours, theirs, measured, ordered
    for end in (ours, theirs):
        end.close()
        end.close()


def test_commands_and_measurements_arrive(ends):
    ours, theirs, measured, ordered = ends
    wait(lambda: ours.waits_for() is None)
    positions = dict(zip(ARM, np.linspace(0.1, 0.8, 8).tolist(), strict=True))
    base = BaseReading(1.5, -2.0, 0.75, np.array([0.1, 0.0, -0.2]), 1e9 + 0.5)
    joints = JointReading({"torso_lift_joint": 0.25, "arm_1_joint": 1.5}, {"arm_1_joint": 0.5})
    ranges = np.full((2, SCAN_BEAMS), [[1.0], [2.0]])

    def arrived():  # what is sent before the readers know the writers is lost
        ours.check()
        ours.drive(np.array([0.1, -0.2, 0.3]))
        ours.move(positions, 0.25)
        ours.grip("close")
        theirs.report(base, joints, ranges)
        theirs.check()
        time.sleep(0.02)
        moved = {name for path in ordered["move"] for name in path.joints}
        scans = {type(reading) for reading in measured["scan"]}
        complete = moved == positions.keys() and scans == ours.scan_sources.keys()
        return complete and all(map(len, (*measured.values(), *ordered.values())))

    wait(arrived)
    np.testing.assert_array_equal(ordered["drive"][-1], [0.1, -0.2, 0.3])
    assert set(ordered["grip"]) == {"close"}
    moved = {}
    for path in ordered["move"]:
        np.testing.assert_array_equal(path.times, [0.25])
        moved |= dict(zip(path.joints, path.positions[0].tolist(), strict=True))
    assert moved == positions
    pose, reading = measured["base"][-1], measured["joints"][-1]
    np.testing.assert_allclose([pose.x, pose.y, pose.yaw], [1.5, -2.0, 0.75], atol=1e-12)
    assert pose.stamp == base.stamp
    if not ours.base_source.startswith("/tf"):
        np.testing.assert_array_equal(pose.velocity, base.velocity)
    assert dict(reading.positions) == dict(joints.positions)
    assert dict(reading.velocities) == {"torso_lift_joint": 0.0, "arm_1_joint": 0.5}
    for scan in measured["scan"]:
        assert scan.stamp == base.stamp
        if isinstance(scan, LaserReading):
            np.testing.assert_allclose(laser_ranges(scan), 1.0)
        else:
            costmap = costmap_ranges(scan, (base.x, base.y, base.yaw))
            np.testing.assert_allclose(costmap, 2.0, atol=0.05)
    # The call of the watchdog stops the base.
    assert ours.shared() == []
    stop = stop_base(2, "/cmd_vel", stamped=ours._topics.base.stamped)
    wait(lambda: ours.shared() == ["/cmd_vel"])
    ours.close()
    wait(lambda: stop() or not np.any(ordered["drive"][-1]))


def test_late_subscribers_get_static_transforms():
    sender, late, heard = Ros2Bus(), Ros2Bus(), []
    sender.open("early")
    edge = MESSAGES.TransformStamped(MESSAGES.Header(frame_id="map"), "odom")
    sender.publisher("/tf_static", MESSAGES.TFMessage).publish(MESSAGES.TFMessage([edge]))
    late.open("late")
    late.subscribe("/tf_static", MESSAGES.TFMessage, heard.append, every=True)
    wait(lambda: heard)
    assert heard[0].transforms[0].child_frame_id == "odom"
    np.testing.assert_array_equal(heard[0].transforms[0].transform.rotation.w, spatial.IDENTITY[6])
    sender.close()
    late.close()


def test_messages_are_handled_in_a_thread_of_the_bus_that_outlives_errors(caplog):
    """In a thread of DDS, an object that the garbage collector deletes crashes the process."""
    sender, receiver, threads = Ros2Bus(), Ros2Bus(), []

    def fail(message):
        threads.append(threading.current_thread().name)
        raise ValueError("boom")

    for bus, name in ((sender, "sender"), (receiver, "receiver")):
        bus.open(name)
    publisher = sender.publisher("/a", sender.messages.Twist)
    receiver.subscribe("/a", receiver.messages.Twist, fail)
    wait(lambda: publisher.publish(sender.messages.Twist()) or len(threads) > 1)
    for bus in (sender, receiver):
        bus.close()
    assert set(threads) == {"receiver"}
    assert "boom" in caplog.text
    assert not {"sender", "receiver"} & {thread.name for thread in threading.enumerate()}


def test_a_bus_closes_while_a_message_is_handled(monkeypatch):
    monkeypatch.setattr("kinfeas.sim2real.ros.ros2._ENDING", 0.0)
    bus, begun, closed = Ros2Bus(), threading.Event(), threading.Event()
    errors = []
    monkeypatch.setattr(threading, "excepthook", errors.append)
    bus.open("slow")
    bus.subscribe("/a", MESSAGES.Twist, lambda message: begun.set() or closed.wait())
    publisher = bus.publisher("/a", MESSAGES.Twist)
    wait(lambda: publisher.publish(MESSAGES.Twist()) or begun.is_set())
    (thread,) = [each for each in threading.enumerate() if each.name == "slow"]
    bus.close()
    closed.set()
    thread.join()
    assert not errors


@pytest.fixture
def bus():
    """A bus that keeps its messages, with one subscriber."""
    made = Mock(messages=MESSAGES)
    made.publisher.return_value.listeners.return_value = 1
    return made


def test_a_simulated_robot_drops_and_counts_velocities_that_are_not_finite(bus):
    topics, taken, drop = read_topics(load_robot("hsr"), 2), [], Mock()
    RosRobotLink(topics, bus).open(Orders(taken.append, taken.append, taken.append, drop))
    subscribed = {call.args[0]: call.args[2] for call in bus.subscribe.call_args_list}
    for x in (np.nan, 0.5):
        message = bus.messages.Twist()
        message.linear.x = x
        subscribed[topics.base.command](message)
    np.testing.assert_array_equal(taken, [[0.5, 0.0, 0.0]])
    drop.assert_called_once_with()


def test_a_simulated_robot_takes_joints_by_the_names_of_its_topics(bus, tmp_path):
    path = tmp_path / "topics.yaml"
    topics = TOPICS.replace("controllers", "names: {torso_lift_joint: lift}\n  controllers")
    topics = topics.replace("[torso_lift_joint]", "[lift]")
    path.write_text(topics % ("false", "odometry", ", ".join(ARM[1:])))
    taken = Mock()
    RosRobotLink(read_topics(TIAGO, 2, str(path)), bus).open(Orders(taken, taken, taken))
    subscribed = {call.args[0]: call.args[2] for call in bus.subscribe.call_args_list}
    message = ros_messages.trajectory(MESSAGES, {"lift": 0.3}, 1.0)
    subscribed["/lift/joint_trajectory"](message)
    assert taken.call_args.args[0].joints == ("torso_lift_joint",)


@pytest.mark.parametrize("stamped", [False, True])
def test_a_stop_is_stamped_and_raises_where_it_is_not_sent(monkeypatch, bus, stamped):
    monkeypatch.setattr(ros_bus, "make_bus", lambda _: bus)
    publisher = bus.publisher.return_value
    stop = stop_base(2, "/cmd_vel", stamped=stamped)
    began = time.time()
    stop()
    (message,) = publisher.publish.call_args.args
    if stamped:
        assert message.header.stamp.to_sec() >= began - 1e-6
    else:
        assert message == bus.messages.Twist()
    publisher.publish.side_effect = Fault
    with pytest.raises(Fault):
        stop()
    publisher.listeners.return_value = 0
    with pytest.raises(KinfeasError, match="/cmd_vel"):
        stop_base(2, "/cmd_vel", timeout=0.0)


def test_a_robot_that_is_not_there_is_an_error(domain):
    robot = load_robot("hsr")
    backend = registry.build("kinfeas.backends", "ros2", {"robot": robot, "timeout": 0.2})
    assert backend.stop_call() is not None
    with pytest.raises(KinfeasError, match=rf"{backend.topics.base.odometry} .*\b{domain}\b"):
        backend.reset(None, None)
    backend.close()


def test_a_wrong_name_of_a_topic_is_an_error():
    bus = Ros2Bus()
    bus.open("test")
    with closing(bus), pytest.raises(KinfeasError, match="'/cmd vel'"):
        bus.subscribe("/cmd vel", MESSAGES.Twist, list)


def test_a_path_in_the_ee_frame_is_a_relative_chunk():
    seen = at(1.0, 2.0, np.pi / 2)
    controller, source, policy = TargetController(TIAGO), Ros2Source(), Ros2Bus()
    rows = np.zeros(1, dtype=np.intp)
    progress = StreamProgress(rows, rows, seen, seen, np.ones(1), 0.02, 0.02)
    controller.start(seen, [np.random.default_rng(0)], rows)
    controller.targets(progress)
    source.start(controller)
    policy.open("policy")
    publisher = policy.publisher("/servo_node/pose_chunk_cmds", MESSAGES.Path)

    def arrived():
        now, path = time.time(), MESSAGES.Path()
        path.header.frame_id, path.header.stamp = TIAGO.ee_frame, MESSAGES.Time.from_sec(now)
        for seconds in (0.0, 1.0):
            pose = MESSAGES.PoseStamped()
            pose.header.stamp = MESSAGES.Time.from_sec(now + seconds)
            pose.pose.position.x = 0.01
            path.poses.append(pose)
        publisher.publish(path)
        time.sleep(0.02)
        return controller.targets(progress)[0, 1] == pytest.approx(2.01, abs=1e-6)

    wait(arrived)
    np.testing.assert_allclose(controller.targets(progress)[0, [0, 2]], [1.0, 0.0], atol=1e-6)
    for bus in (source, policy):
        bus.close()


@pytest.fixture
def server(monkeypatch):
    """A socket that listens, as a master does."""
    listening = socket.create_server(("127.0.0.1", 0))
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{listening.getsockname()[1]}")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    yield listening
    listening.close()


def test_notices_that_the_master_died(server):
    watch = MasterWatch()
    connection, _ = server.accept()
    watch.check()
    connection.shutdown(socket.SHUT_RDWR)
    select.select([watch._socket], [], [], 60.0)
    with pytest.raises(Fault, match="master"):
        watch.check()
    connection.close()
    watch.close()
    watch.close()


def test_no_master_is_an_error(server):
    server.close()
    with pytest.raises(KinfeasError, match=r"no ROS master at http://127\.0\.0\.1"):
        MasterWatch()
