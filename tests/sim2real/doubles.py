"""Test doubles: simulated clocks and a link that records commands."""

import numpy as np

from kinfeas.core.errors import Fault
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.rate import Clock


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
