"""A source of EE targets in Python: a circle around the pose at the start.

kinfeas servo pretrained --robot pr2 --source examples.target_source:Circle --seconds 20
"""

import threading
import time

import numpy as np

from kinfeas.sim2real.servo.controller import TargetController


class Circle:
    """Sends poses on a horizontal circle from a thread.

    Args:
        radius: Metres.
        period: Seconds for one turn.
        rate: Poses in a second.
    """

    def __init__(self, radius: float = 0.2, period: float = 20.0, rate: float = 30.0) -> None:
        self.radius, self.period, self.rate = radius, period, rate
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, controller: TargetController) -> None:
        """Begin to send."""
        self._thread = threading.Thread(target=self._send, args=(controller,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join()

    def _send(self, controller: TargetController) -> None:
        while not controller.running and not self._ends.wait(0.01):
            pass
        centre, began = controller.pose, time.monotonic()
        while not self._ends.wait(1.0 / self.rate):
            angle = 2.0 * np.pi * (time.monotonic() - began) / self.period
            pose = centre.copy()
            pose[:2] += self.radius * np.array([np.sin(angle), 1.0 - np.cos(angle)])
            controller.set_target(pose)
