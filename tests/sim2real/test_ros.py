import signal
import time

import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.io.run_log import read_record
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from tests.builders import wait
from tests.sim2real.ros_processes import LIMIT, SEND, Ros1, Ros2, needs_ros1

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[pytest.param(Ros1, marks=needs_ros1), Ros2])
def buses(request, tmp_path_factory):
    made = []

    def living():
        if not made or made[-1].dead:
            made.append(request.param(tmp_path_factory.mktemp("bus")))
        return made[-1]

    yield living
    for bus in made:
        bus.close()


@pytest.fixture
def bus(buses):
    return buses()


of_ros1 = pytest.mark.parametrize(
    "buses", [pytest.param(Ros1, marks=needs_ros1)], indirect=True, ids=["Ros1"]
)
"""Only ROS 1 has a master, and nodes that it can shut down."""


def test_reaches_a_goal_over_the_link(bus, tmp_path):
    robot, record = bus.robot(), tmp_path / "record.csv"
    pr2 = load_robot("pr2")
    ee = forward(IkSolver(pr2).chain, pr2.home["home"][np.newaxis])[0]
    # Beyond the arm; farther away if an earlier test has moved the robot.
    goal = [f"{value:.4f}" for value in ee[:3] + np.array([0.8, -0.1, 0.05])]
    settings = "--set", "generator.gain=1.0", "--set", "time_scale=1", "--seconds", "300"
    deployment = bus.deploy("--goal", *goal, *settings, "--record", str(record))
    assert deployment.end() == 0, deployment.output() + robot.output()
    run = read_record(record)
    assert np.nanmax(run.age) < 1.0
    assert np.abs(run.base_twist).max() > 0.01
    np.testing.assert_allclose(run.joint_positions[-1], run.joint_targets[-1], atol=0.05)
    reached = forward(IkSolver(pr2).chain, run.joint_positions[-1:])
    place = spatial.compose(run.base_pose[-1:], reached)
    assert np.linalg.norm(place[0, :3] - run.goal[-1, :3]) <= 0.03
    wait(lambda: np.all(bus.heard("command")[-1, 1:] == 0.0))


def far(bus, record):
    """Return a deployment that moves the base, for minutes."""
    begin = time.monotonic()
    deployment = bus.deploy("--goal", "9", "9", "0.8", "--record", str(record))
    bus.wait_for_motion(deployment, begin)
    return deployment


@pytest.mark.parametrize("stall", [False, True])
def test_the_base_stops_when_the_deployment_is_killed_or_stalls(bus, tmp_path, stall):
    bus.robot()
    deployment = far(bus, tmp_path / "record.csv")
    stopped = time.monotonic()
    deployment.send_signal(signal.SIGSTOP if stall else signal.SIGKILL)
    assert bus.seconds_to_zero(stopped) <= LIMIT
    assert bus.seconds_to_zero(stopped, "moves", 0.01) <= LIMIT
    if stall:
        deployment.send_signal(signal.SIGCONT)
        assert bus.seconds_to_zero(stopped) <= LIMIT
    assert deployment.end() == (3 if stall else -signal.SIGKILL)
    assert len(read_record(tmp_path / "record.csv").time) > 10


def test_the_base_is_commanded_to_zero_when_the_robot_falls_silent(bus, tmp_path):
    robot = bus.robot()
    deployment = far(bus, tmp_path / "record.csv")
    killed = robot.killed()
    assert bus.seconds_to_zero(killed) <= LIMIT
    assert deployment.end() == 3
    assert " s old" in deployment.output()
    assert " s old" in read_record(tmp_path / "record.csv").event[-1]


def test_servo_stops_within_0_3_s_after_the_last_twist(bus, tmp_path):
    bus.robot()
    source, record = f"ros{bus.version}", tmp_path / "record.csv"
    words = ("--source", source, "--seconds", "600", "--record", str(record))
    begin, servo = time.monotonic(), bus.deploy(*words, command="servo")
    sender = bus.run(SEND, str(bus.version))
    bus.wait_for_motion(servo, begin)
    ended = sender.killed()
    assert bus.seconds_to_zero(ended) <= 0.3
    servo.send_signal(signal.SIGINT)
    servo.end()
    run = read_record(record)
    moved = np.linalg.norm(np.diff(run.desired[:, :3], axis=0), axis=1) / np.diff(run.time)
    assert moved.max() > 0.05
    assert moved[-1] < 1e-3
    assert run.feasible.all()


@of_ros1
def test_the_base_is_commanded_to_zero_when_the_master_dies(bus, tmp_path):
    robot = bus.robot()
    deployment = far(bus, tmp_path / "record.csv")
    killed = bus.kill_master()
    assert bus.seconds_to_zero(killed) <= LIMIT
    assert deployment.end() == 3
    died = f"the ROS master at {bus.uri} died"
    assert died in deployment.output()
    assert died in read_record(tmp_path / "record.csv").event[-1]
    assert robot.end() == 2
    assert died in robot.output()
