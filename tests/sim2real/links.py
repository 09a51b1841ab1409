"""A link without a bus, for tests: what is sent is kept, what arrives is said by the test."""

import numpy as np

from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.fault import Fault


class MemoryLink:
    """Keeps what is sent; hands on what `answer` says as soon as it is opened."""

    base_source, joint_source = "the odometer", "the encoders"

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
    """Return positions by name, the arm at home by default."""
    values = robot.home["home"] if positions is None else positions
    named = dict(zip((joint.name for joint in robot.arm), np.asarray(values).tolist(), strict=True))
    return JointReading({**robot.fixed_joints, **named, **others})


def present(robot, x=1.0, y=2.0, yaw=0.5, **base):
    """Return an answer of a robot at home."""

    def answer(readings):
        readings.base(BaseReading(x, y, yaw, **base))
        readings.joints(joints_at(robot))

    return answer


def connected(robot, **where):
    """Return a backend, and its link, of a robot that has answered."""
    link = MemoryLink(present(robot, **where))
    backend = LinkBackend(robot, link)
    backend.reset(None, None)
    return backend, link
