"""A simulated robot on ROS, a listener and a deployment, each in its own process."""

import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from xmlrpc.client import ServerProxy

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros import ros1
from kinfeas.sim2real.ros.topics import read_topics
from tests.builders import TIMEOUT, wait


def _ros1_is_there() -> bool:
    path = list(sys.path)
    try:
        for name in ("rospy", "nav_msgs.msg", "tf2_msgs.msg", "trajectory_msgs.msg"):
            ros1.ros(name)
    except KinfeasError:
        return False
    finally:
        sys.path[:] = path
    return shutil.which("roscore") is not None


needs_ros1 = pytest.mark.skipif(
    not _ros1_is_there(),
    reason="ROS 1 is not installed: apt install python3-rospy python3-roslaunch python3-nav-msgs "
    "python3-sensor-msgs python3-trajectory-msgs python3-tf2-msgs",
)

LIMIT = 5.0
"""Seconds within which the base must be commanded to zero on a busy machine."""

_BUSY = (
    "guards.max_age=2", "guards.max_scan_age=2", "guards.max_period=1", "guards.max_clock_skew=1",
    "guards.max_tracking_delay=5", "guards.watchdog=1", "backend.timeout=120",
)  # fmt: skip
"""Guards of deployments: with the defaults, a busy machine ends them before a test does."""

_COMMAND = "from kinfeas.cli.main import main; main()"
_LISTEN = """
import os, sys, time
from kinfeas.sim2real.ros.bus import make_bus
def show(mark, twist):
    numbers = time.monotonic(), twist.linear.x, twist.linear.y, twist.angular.z
    os.write(1, f"{mark} {' '.join(map(str, numbers))}\\n".encode())  # whole lines, from threads
bus = make_bus(int(sys.argv[3]))
bus.open("listener")
kinds = bus.messages
bus.subscribe(sys.argv[1], kinds.Twist, lambda message: show("command", message))
bus.subscribe(sys.argv[2], kinds.Odometry, lambda message: show("moves", message.twist.twist))
print("listens", flush=True)
while True:
    time.sleep(1.0)
"""
SEND = """
import sys, time
from kinfeas.sim2real.ros.bus import make_bus
bus = make_bus(int(sys.argv[1]))
bus.open("sender")
kinds, topic = bus.messages, "/servo_node/delta_twist_cmds"
publisher = bus.publisher(topic, kinds.TwistStamped)
message = kinds.TwistStamped()
message.header.frame_id, message.twist.linear.x = "odom", 0.1
while True:
    message.header.stamp = type(message.header.stamp).from_sec(time.time())
    publisher.publish(message)
    time.sleep(0.03)
"""


class Process(subprocess.Popen):
    def __init__(self, code: str, arguments: tuple[str, ...], out: Path, env: dict) -> None:
        command, self.out = [sys.executable, "-c", code, *arguments], out
        with out.open("w") as file:
            super().__init__(command, env=env, stdout=file, stderr=file, stdin=subprocess.DEVNULL)

    def output(self) -> str:
        return self.out.read_text()

    def until(self, condition) -> None:
        """Wait until something holds; fail at once if the process ends before."""
        wait(lambda: condition() or self.poll() is not None)
        assert condition(), self.output()

    def end(self) -> int:
        return self.wait(TIMEOUT)

    def killed(self) -> float:
        """Kill the process, and return when."""
        now = time.monotonic()
        self.kill()
        self.wait()
        return now


class Bus:
    version: int
    dead = False  # cannot be used any more

    def __init__(self, folder: Path, env: dict[str, str]) -> None:
        self.folder, self.env = folder, os.environ | env
        self.started: list[Process] = []
        self._robot: Process | None = None
        topics = read_topics(load_robot("pr2"), self.version).base
        self.listener = self.run(_LISTEN, topics.command, topics.odometry, str(self.version))
        self.listener.until(lambda: "listens" in self.listener.output())

    def run(self, code: str, *arguments: str) -> Process:
        out = self.folder / f"{len(self.started)}.txt"
        self.started.append(Process(code, arguments, out, self.env))
        return self.started[-1]

    def robot(self) -> Process:
        if self._robot is None or self._robot.poll() is not None:
            played = ["simulate", "--backend", f"ros{self.version}", "--robot", "pr2"]
            self._robot = self.run(_COMMAND, *played, "--seconds", "2000")
        self._robot.until(lambda: "is ready" in self._robot.output())
        return self._robot

    def deploy(self, *arguments: str, command: str = "deploy") -> Process:
        words = [command, "pretrained", "--robot", "pr2", "--backend", f"ros{self.version}"]
        settings = (word for setting in _BUSY for word in ("--set", setting))
        return self.run(_COMMAND, *words, *arguments, *settings)

    def heard(self, mark: str) -> np.ndarray:
        """Return what the listener received: rows of time, x, y and rotation."""
        lines = self.listener.output().splitlines(keepends=True)
        rows = [line.split()[1:] for line in lines if line.startswith(mark) and line[-1] == "\n"]
        return np.array(rows, dtype=float).reshape(-1, 4)

    def wait_for_motion(self, deployment: Process, since: float) -> None:
        """Wait until the base is commanded, and seen, to move for a while after `since`."""

        def moves() -> bool:
            both = (self.heard(mark) for mark in ("command", "moves"))
            fast = ((rows[:, 0] > since) & (np.abs(rows[:, 1:]).max(1) > 0.02) for rows in both)
            return all(rows.sum() > 15 for rows in fast)

        deployment.until(moves)

    def seconds_to_zero(self, since: float, mark: str = "command", small: float = 0.0) -> float:
        """Wait until the base is at rest; return how long after `since` it moved last."""

        def last_moves() -> float:
            rows = self.heard(mark)
            moving = rows[np.abs(rows[:, 1:]).max(axis=1) > small, 0]
            last = float(moving.max(initial=since))
            return math.inf if rows[-1, 0] <= last else last

        wait(lambda: time.monotonic() > last_moves() + 0.5)
        return last_moves() - since

    def close(self) -> None:
        for process in self.started:
            process.killed()


class Ros1(Bus):
    version = 1

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self.uri = f"http://127.0.0.1:{port}"
        home = {"ROS_HOME": str(folder / "ros"), "ROS_LOG_DIR": str(folder / "ros/log")}
        env = {**home, "ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1"}
        with (folder / "roscore.log").open("w") as log:
            command = ["roscore", "-p", str(port)]
            self._core = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | env)
        wait(self._answers)
        super().__init__(folder, env)

    def kill_master(self) -> float:
        """Kill the master, as a crash would, and return when."""
        _, _, pid = ServerProxy(self.uri).getPid("/test")
        self.dead, now = True, time.monotonic()
        os.kill(pid, signal.SIGKILL)
        return now

    def close(self) -> None:
        super().close()
        self._core.send_signal(signal.SIGINT)
        try:
            self._core.wait(15.0)
        except subprocess.TimeoutExpired:
            self._core.kill()

    def _answers(self) -> bool:
        try:
            return ServerProxy(self.uri).getPid("/test")[0] == 1
        except OSError:
            return False


class Ros2(Bus):
    version = 2

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, {"ROS_DOMAIN_ID": own_domain(), "ROS_LOCALHOST_ONLY": "1"})


def own_domain() -> str:
    return str(1 + os.getpid() % 100)
