import os
import struct
import time

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import planar_pose
from kinfeas.sim2real.ros.ros2 import PoseStamped, Time, TwistStamped
from kinfeas.sim2real.servo.devices import Gamepad, Keyboard
from kinfeas.sim2real.servo.ros import _pose, _twist
from tests.sim2real.doubles import wait


class Controller:
    def __init__(self):
        self.base_pose, self.twists, self.running = planar_pose(0.0, 0.0, np.pi / 2.0), [], True

    def set_twist(self, twist, stamp=None, frame=""):
        self.twists.append((np.asarray(twist), frame, time.monotonic()))
        self.base_pose = planar_pose(0.0, 0.0, 0.3)


def test_a_gamepad_sends_its_axes_until_they_are_centred(tmp_path):
    os.mkfifo(tmp_path / "js0")
    gamepad, controller = Gamepad(tmp_path / "js0", speed=0.1, angular_speed=0.3), Controller()
    gamepad.start(controller)
    with (tmp_path / "js0").open("wb", buffering=0) as device:
        device.write(struct.pack("<IhBB", 0, -32767, 0x82, 1))
        device.write(struct.pack("<IhBB", 0, -32767, 0x02, 3))
        wait(lambda: controller.twists)
        device.write(struct.pack("<IhBB", 0, 0, 0x02, 1) + struct.pack("<IhBB", 0, 500, 0x02, 3))
        wait(lambda: not gamepad._shares().any())
        wait(lambda: time.monotonic() - controller.twists[-1][2] > 0.2)
        gamepad.close()
    # The axes of the base at the start, although it turns.
    np.testing.assert_allclose(controller.twists[-1][0][:2], [0.0, 0.1], atol=1e-4)
    assert not controller.twists[-1][1]


def test_devices_that_are_missing_raise(tmp_path, monkeypatch):
    with pytest.raises(KinfeasError, match="js9"):
        Gamepad(tmp_path / "js9").start(Controller())
    monkeypatch.setattr("sys.stdin", (tmp_path / "no").open("w+"))
    with pytest.raises(KinfeasError, match="terminal"):
        Keyboard().start(Controller())


def test_messages_of_ros_have_the_numbers_of_poses_and_twists():
    twist, pose = TwistStamped(), PoseStamped()
    twist.header.stamp = Time.from_sec(2.5)
    twist.twist.linear.x, twist.twist.angular.z = 0.1, 0.2
    pose.pose.position.y, pose.pose.orientation.w = 1.0, 1.0
    assert _twist(twist) == [0.1, 0.0, 0.0, 0.0, 0.0, 0.2]
    assert _pose(pose) == [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    assert twist.header.stamp.to_sec() == 2.5
