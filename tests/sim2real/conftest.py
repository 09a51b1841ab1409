"""Test doubles: clocks, a link that records commands, adapters around a recorder, ROS domains."""

import os

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.errors import Fault
from kinfeas.core.spatial import planar_pose
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.rate import Clock
from tests.sim2real.ros_processes import own_domain


class Time:
    """Clocks that a test advances; sleeping does so, too."""

    def __init__(self):
        self.monotonic = self.wall = 1000.0
        self.clock = Clock(lambda: self.monotonic, lambda: self.wall, self.passes)

    def passes(self, seconds):
        self.monotonic += seconds
        self.wall += seconds


class MemoryLink:
    """A link whose robot sends the readings of `answer` when it is opened, and on request."""

    base_source, joint_source = "/odometer", "/encoders"

    def __init__(self, answer=lambda readings: None, deaf=None):
        self.answer, self.deaf, self.broken = answer, deaf, None
        self.driven, self.moved, self.gripped, self.closed = [], [], [], 0

    def open(self, readings):
        self.readings = readings
        self.answer(readings)

    def waits_for(self):
        return self.deaf

    def check(self):
        if self.broken:
            raise Fault(self.broken)

    def drive(self, velocity):
        self.driven.append(velocity.copy())

    def move(self, positions, seconds):
        self.moved.append((dict(positions), seconds))

    def grip(self, grip):
        self.gripped.append(grip)

    def close(self):
        self.closed += 1


def joints_at(robot, positions=None, **others):
    """Return a reading of all joints, the arm at home by default."""
    values = robot.home["home"] if positions is None else positions
    named = dict(zip((joint.name for joint in robot.arm), np.asarray(values).tolist(), strict=True))
    return JointReading({**robot.fixed_joints, **named, **others})


def present(robot, x=1.0, y=2.0, yaw=0.5, joints=None):
    """Return an answer of a robot that measures its base and all joints."""

    def answer(readings):
        readings.base(BaseReading(x, y, yaw))
        readings.joints(joints or joints_at(robot))

    return answer


def connected(robot, time, **where):
    """Return a backend, after its reset, and its link."""
    link = MemoryLink(present(robot, **where))
    backend = LinkBackend(robot, link, clock=time.clock)
    backend.reset(None, None)
    return backend, link


class Recorder(AnalyticBackend):
    """The analytic world, which keeps what gets through to it."""

    def __init__(self):
        super().__init__()
        self.twists, self.targets = [], []

    def step(self, base_twist, joint_targets, dt):
        self.twists.append(base_twist.copy())
        self.targets.append(joint_targets.copy())
        return super().step(base_twist, joint_targets, dt)


class Rig:
    """An adapter around a recorder, driven step by step."""

    def __init__(self, adapter, robot, n=1, first_seed=0, **parameters):
        self.recorder, self.robot = Recorder(), robot
        self.adapter = adapter(self.recorder, robot, **parameters)
        self.n, self.j = n, len(robot.arm)
        self.joints = np.zeros((n, self.j))
        self.adapter.seed(np.arange(first_seed, first_seed + n, dtype=np.uint64), np.arange(n))
        self.first = self.adapter.reset(planar_pose(*np.zeros((3, n))), self.joints)

    def run(self, twists, dt=0.1, targets=None):
        """Return the states after each of the twists, (steps, n, 6) or (steps, 6)."""
        states = []
        for i, twist in enumerate(twists):
            joints = np.broadcast_to(
                self.joints if targets is None else targets[i], (self.n, self.j)
            )
            states.append(self.adapter.step(np.broadcast_to(twist, (self.n, 6)), joints, dt))
        return states

    @property
    def passed(self):
        """Twists that got through, shape (steps, n, 6)."""
        return np.stack(self.recorder.twists)

    @property
    def sent(self):
        """Joint targets that got through, shape (steps, n, j)."""
        return np.stack(self.recorder.targets)


@pytest.fixture
def time():
    return Time()


@pytest.fixture(scope="module")
def domain():
    """A domain of ROS 2 on this computer alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", os.environ.get("CYCLONEDDS_URI", ""))  # restored at the end
        if not os.environ["CYCLONEDDS_URI"]:
            patch.delenv("CYCLONEDDS_URI")
        patch.setenv("ROS_DOMAIN_ID", own_domain())
        patch.setenv("ROS_LOCALHOST_ONLY", "1")
        yield int(own_domain())


@pytest.fixture(scope="session")
def rig(pr2):
    return lambda adapter, **arguments: Rig(adapter, pr2, **arguments)


@pytest.fixture(scope="session")
def drive():
    """Return a function that draws commands for the base, shape (steps, n, 6)."""

    def drawn(steps, n=1, seed=0):
        twists = np.zeros((steps, n, 6))
        twists[..., [0, 1, 5]] = np.random.default_rng(seed).normal(scale=0.2, size=(steps, n, 3))
        return twists

    return drawn
