"""Measurements that arrive late."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array, integrate, twist_between
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory, measured
from kinfeas.sim2real.adapters.delay_buffer import LATEST, around, filled, pushed, slots_for
from kinfeas.sim2real.adapters.draws import Number

_POSES, _JOINTS = ("base_pose", "ee_in_base"), "joint_positions"
_MEASURED = (*_POSES, _JOINTS, "base_twist", "joint_velocities", "age")


class SensorLatency(Adapter):
    """Shows the robot as it was some time ago; at the start of an episode, as it then stood.

    Between two measurements it is interpolated. A reading that is later than the one before it
    never shows an older robot.
    """

    def __init__(
        self, backend: Backend, robot: Robot, *, seconds: Number = 0.03, jitter: Number = 0.0
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What measures.
            robot: Whom it moves.
            seconds: Shortest delay of a reading, s.
            jitter: By how much a reading is later at most, s, uniformly and each for itself.

        Raises:
            ValueError: If a time is not in [0, 60] s.
        """
        super().__init__(backend, robot, {"seconds": seconds, "jitter": jitter}, LATEST)

    def on_reset(self, state: RobotState) -> Memory:
        """Return a line that is full of the robot as it stands."""
        slots = self.memory["times"].shape[1] if self.memory else 1
        n = len(state.base_pose)
        times = np.full((n, slots), -np.inf)
        times[:, -1] = 0.0
        lines = {name: filled(values, slots) for name, values in _measurements(state).items()}
        return {"clock": np.zeros(n), "shown": np.zeros(n), "times": times, **lines}

    def on_step(self, state: RobotState, dt: float) -> None:
        """Put what was measured into the line, and go on to what arrives now."""
        slots = slots_for(self.ranges["seconds"].high + self.ranges["jitter"].high, dt)
        late = self.number("seconds") + self.number("jitter") * self.uniform(1)
        clock = self.memory["clock"] + dt
        shown = np.maximum(self.memory["shown"], clock - late[:, 0])
        times = pushed(self.memory["times"], clock, slots)
        lines = {}
        for name, values in _measurements(state).items():
            line = self.memory.get(name)
            before = filled(values, times.shape[1] - 1) if line is None else line
            lines[name] = pushed(before, values, slots)
        self.remember(clock=clock, shown=shown, times=times, **lines)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state as it was."""
        index, share = around(self.memory["times"], self.memory["shown"])
        was = {
            name: self._between(name, self.memory[name], index, share)
            for name in _MEASURED
            if name in self.memory
        }
        age = self.memory["clock"] - self.memory["shown"]
        was["age"] = age + was["age"] if "age" in was else age
        return measured(state, **was)

    def _between(self, name: str, line: Array, index: NDArray[np.intp], share: Array) -> Array:
        """Return what a line, shape (n, s, ...), holds at `index`, and `share` of the way on."""
        rows, share = np.arange(len(line)), share.reshape(-1, *(1 for _ in line.shape[2:]))
        before, after = line[rows, index], line[rows, np.minimum(index + 1, line.shape[1] - 1)]
        if name in _POSES:
            moved = integrate(before, twist_between(before, after, 1.0) * share, 1.0)
        elif name == _JOINTS:
            moved = self.joints(before + self.turned(before, after) * share)
        else:
            moved = before + (after - before) * share
        return np.where(share > 0.0, moved, before)


def _measurements(state: RobotState) -> dict[str, Array]:
    """Return what was measured, by the names of the state's fields."""
    found = {name: getattr(state, name) for name in _MEASURED}
    return {name: values for name, values in found.items() if values is not None}
