"""Targets from a keyboard and from a gamepad: twists along the axes of the base."""

import logging
import os
import select
import struct
import sys
import termios
import threading
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, yaw
from kinfeas.sim2real.servo.controller import TargetController

_log = logging.getLogger(__name__)

_PERIOD = 0.03  # s between twists
_HELD = 0.4  # s for which a key counts as held: terminals repeat keys after a while
_KEYS = "wsadqeikjluo"  # pairs: forward, left, up, pitch, yaw and roll
_COMPONENTS = (0, 1, 2, 4, 5, 3)  # of the twist that the pairs of keys move
_AXES = ((1, -1.0), (0, -1.0), (7, -1.0), (6, 1.0), (4, 1.0), (3, -1.0))  # and their signs
_EVENT, _AXIS = struct.Struct("<IhBB"), 0x02
_DEAD = 0.08  # share of an axis within which it counts as centred


class _Device:
    """Sends twists while there is input, from a thread.

    Axes are those that the base has when the input begins: the base turns while it makes room for
    the arm, and the EE would turn with it.
    """

    def __init__(self, speed: float, angular_speed: float) -> None:
        self._scale = np.repeat([speed, angular_speed], 3)
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, controller: TargetController) -> None:
        """Open the device and begin to send."""
        descriptor = self._open()

        def send() -> None:
            heading, moves = 0.0, False
            try:
                while not self._ends.is_set():
                    if select.select([descriptor], [], [], _PERIOD)[0]:
                        self._read(descriptor)
                    twist, moved = self._shares() * self._scale, moves
                    if moves := bool(twist.any()) and controller.running:
                        heading = heading if moved else float(yaw(controller.base_pose))
                        turn = Rotation.from_euler("z", heading)
                        controller.set_twist(turn.apply(twist.reshape(2, 3)).ravel())
            except OSError as error:  # unplugged: the stream ends
                _log.warning("target source: %s", error)

        self._thread = threading.Thread(target=send, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join()

    def _open(self) -> int:
        raise NotImplementedError

    def _read(self, descriptor: int) -> None:
        raise NotImplementedError

    def _shares(self) -> Array:
        raise NotImplementedError


class Keyboard(_Device):
    """Keys of the terminal: w s forward, a d left, q e up, i k pitch, j l yaw, u o roll.

    Args:
        speed: Linear velocity, m/s.
        angular_speed: Angular velocity, rad/s.
    """

    def __init__(self, speed: float = 0.05, angular_speed: float = 0.2) -> None:
        super().__init__(speed, angular_speed)
        self._pressed: dict[int, tuple[float, float]] = {}
        self._mode: list[Any] | None = None

    def close(self) -> None:
        """End the thread and restore the terminal."""
        super().close()
        if self._mode is not None:
            termios.tcsetattr(0, termios.TCSADRAIN, self._mode)
            self._mode = None

    def _open(self) -> int:
        if not sys.stdin.isatty():
            raise KinfeasError("the source keyboard needs a terminal")
        self._mode = termios.tcgetattr(0)
        tty.setcbreak(0)
        return 0

    def _read(self, descriptor: int) -> None:
        for key in os.read(descriptor, 64).decode(errors="ignore"):
            if (place := _KEYS.find(key)) >= 0:
                self._pressed[place // 2] = 1.0 - 2.0 * (place % 2), time.monotonic()

    def _shares(self) -> Array:
        shares, now = np.zeros(6), time.monotonic()
        for axis, (sign, pressed) in self._pressed.items():
            shares[_COMPONENTS[axis]] = sign * (now - pressed < _HELD)
        return shares


class Gamepad(_Device):
    """A gamepad by the joystick interface of Linux.

    Left stick forward and left, cross up and roll, right stick pitch and yaw.

    Args:
        device: Joystick device.
        speed: Linear velocity at a full axis, m/s.
        angular_speed: Angular velocity at a full axis, rad/s.
    """

    def __init__(
        self,
        device: Path = Path("/dev/input/js0"),
        speed: float = 0.1,
        angular_speed: float = 0.3,
    ) -> None:
        super().__init__(speed, angular_speed)
        self._device, self._axes = device, np.zeros(256)
        self._descriptor = -1

    def close(self) -> None:
        """End the thread and close the device."""
        super().close()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _open(self) -> int:
        try:
            self._descriptor = os.open(self._device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise KinfeasError(f"the gamepad cannot be opened: {error}") from error
        return self._descriptor

    def _read(self, descriptor: int) -> None:
        for _, value, kind, number in _EVENT.iter_unpack(os.read(descriptor, 64 * _EVENT.size)):
            if kind & _AXIS:
                self._axes[number] = value / 32767.0

    def _shares(self) -> Array:
        shares = np.array([sign * self._axes[number] for number, sign in _AXES])
        return np.where(np.abs(shares) < _DEAD, 0.0, np.clip(shares, -1.0, 1.0))
