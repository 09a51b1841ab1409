"""A transport for a robot on UDP: each message is a JSON datagram.

Material for a package of your own: docs/ros.md, Custom transports.
"""

# ruff: noqa: D102  the protocols Link and RobotLink document the methods

import json
import socket
import threading

import numpy as np

from kinfeas.core.backend import StopCall
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading
from kinfeas.sim2real.link.backend import LinkBackend

OURS, ROBOTS = ("127.0.0.1", 14550), ("127.0.0.1", 14551)


class Port:
    """One end of the link: sends datagrams and passes received ones to `take`."""

    def __init__(self, here, there, take):
        self.there, self.open = there, True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(here)
        self.socket.settimeout(0.1)
        threading.Thread(target=self.listen, args=(take,), daemon=True).start()

    def send(self, **message):
        self.socket.sendto(json.dumps(message).encode(), self.there)

    def listen(self, take):
        while self.open:
            try:
                take(json.loads(self.socket.recv(65536)))
            except (TimeoutError, ValueError, TypeError, LookupError):  # none, or another program's
                continue
        self.socket.close()


class UdpLink:
    """The deployment's end of the link."""

    base_source = joint_source = f"UDP port {OURS[1]}"
    port = None

    def open(self, readings):
        def take(message):
            x, y, yaw, *velocity = message["base"]
            readings.base(BaseReading(x, y, yaw, np.array(velocity), message["stamp"]))
            readings.joints(JointReading(message["joints"], stamp=message["stamp"]))

        self.port = Port(OURS, ROBOTS, take)

    def waits_for(self):
        return None  # UDP has no connections

    def check(self):
        pass  # a lost link shows as the age of measurements

    def drive(self, velocity):
        self.port.send(drive=velocity.tolist())

    def move(self, positions, seconds):
        self.port.send(move=positions, seconds=seconds)

    def grip(self, grip):
        self.port.send(grip=grip)

    def close(self):
        self.port.open = False


class UdpRobotLink:
    """The robot's end of the link."""

    port = None

    def open(self, orders):
        def take(message):
            if "drive" in message:
                orders.drive(np.array(message["drive"]))
            if "move" in message:
                names, positions = zip(*message["move"].items(), strict=True)
                times = np.array([message["seconds"]])
                orders.move(JointPath(names, times, np.array([positions])))
            if "grip" in message:
                orders.grip(message["grip"])

        self.port = Port(ROBOTS, OURS, take)

    def check(self):
        pass

    def report(self, base, joints, ranges):  # without a scanner
        pose = [base.x, base.y, base.yaw, *base.velocity.tolist()]
        self.port.send(base=pose, joints=dict(joints.positions), stamp=base.stamp)

    def close(self):
        self.port.open = False


class UdpBackend(LinkBackend):
    """Entry point udp = "my_robot.udp:UdpBackend" in the group kinfeas.backends."""

    def __init__(self, robot, *, seconds=0.1, timeout=5.0):
        super().__init__(robot, UdpLink(), seconds=seconds, timeout=timeout)

    def stop_call(self):  # for the watchdog process
        return StopCall("my_robot.udp:stop_base")

    @staticmethod
    def robot_link(robot, topics=None):  # for kinfeas simulate --backend udp
        return UdpRobotLink()


def stop_base():
    """Return a function that commands zero velocity; slow set-up happens before, in this call."""
    port, zero = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), json.dumps({"drive": [0, 0, 0]})
    return lambda: port.sendto(zero.encode(), ROBOTS)
