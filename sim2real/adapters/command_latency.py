"""Commands that arrive late."""

import numpy as np

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory
from kinfeas.sim2real.adapters.delay_buffer import (
    LATEST,
    filled,
    in_force,
    mixed,
    pushed,
    slots_for,
)
from kinfeas.sim2real.adapters.draws import Number


class CommandLatency(Adapter):
    """Delays each command by a time of its own; until the first arrives, the robot stands still.

    The newest command that has arrived is in force. Where another one takes over within a control
    period, the mean of the two by time is passed on.
    """

    def __init__(
        self, backend: Backend, robot: Robot, *, seconds: Number = 0.06, jitter: Number = 0.0
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the late commands.
            robot: Whom it moves.
            seconds: Shortest delay of a command, s.
            jitter: By how much a command is later at most, s, uniformly and each for itself.

        Raises:
            ValueError: If a time is not in [0, 60] s.
        """
        super().__init__(backend, robot, {"seconds": seconds, "jitter": jitter}, LATEST)

    def on_reset(self, state: RobotState) -> Memory:
        """Return a line that is full of the command to stand still."""
        slots = self.memory["arrivals"].shape[1] if self.memory else 1
        joints = state.joint_positions
        return {
            "clock": np.zeros(len(joints)),
            "arrivals": np.full((len(joints), slots), -np.inf),
            "twists": np.zeros((len(joints), slots, 6)),
            "targets": filled(joints, slots),
        }

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the command in force."""
        slots = slots_for(self.ranges["seconds"].high + self.ranges["jitter"].high, dt)
        late = self.number("seconds") + self.number("jitter") * self.uniform(1)
        now = self.memory["clock"]
        arrivals = pushed(self.memory["arrivals"], now + late[:, 0], slots)
        twists = pushed(self.memory["twists"], twist, slots)
        joint_command = pushed(self.memory["targets"], targets, slots)
        clock = now + dt
        self.remember(clock=clock, arrivals=arrivals, twists=twists, targets=joint_command)
        shares = in_force(arrivals, now, dt)
        straight = np.zeros(6, dtype=np.bool_)
        # A copy, for kernels are compiled anew for arrays that are read-only.
        joints = self.joints(mixed(joint_command, shares, self.continuous.copy()))
        return mixed(twists, shares, straight), joints
