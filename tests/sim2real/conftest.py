"""Test doubles: clocks, a link that records commands, adapters in a rig, a domain of ROS."""

import os
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
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
        self.answer, self.driven, self.moved, self.gripped = answer, [], [], []
        self.drive, self.grip = self.driven.append, self.gripped.append
        self.check, self.close, self.waits_for = Mock(), Mock(), Mock(return_value=deaf)

    def open(self, readings):
        self.readings = readings
        self.answer(readings)

    def move(self, positions, seconds):
        self.moved.append((dict(positions), seconds))


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


class Rig:
    """An adapter around the analytic world, driven step by step."""

    def __init__(self, adapter, robot, n=1, first_seed=0, **parameters):
        backend, self.robot = AnalyticBackend(), robot
        self.steps = backend.step = Mock(wraps=backend.step)
        self.adapter = adapter(backend, robot, **parameters)
        self.n, self.joints = n, np.zeros((n, len(robot.arm)))
        self.adapter.seed(np.arange(first_seed, first_seed + n, dtype=np.uint64), np.arange(n))
        self.first = self.adapter.reset(planar_pose(*np.zeros((3, n))), self.joints)

    def run(self, twists, dt=0.1, targets=None):
        """Return the states after each of the twists, (steps, n, 6) or (steps, 6)."""
        states, shape = [], self.joints.shape
        for i, twist in enumerate(twists):
            joints = self.joints if targets is None else np.broadcast_to(targets[i], shape)
            states.append(self.adapter.step(np.broadcast_to(twist, (self.n, 6)), joints, dt))
        return states

    @property
    def passed(self):
        """Twists that got through, shape (steps, n, 6)."""
        return np.stack([call.args[0] for call in self.steps.call_args_list])

    @property
    def sent(self):
        """Joint targets that got through, shape (steps, n, j)."""
        return np.stack([call.args[1] for call in self.steps.call_args_list])


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
