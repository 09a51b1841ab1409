"""Noise on commands and measurements, and errors of localisation."""

from dataclasses import replace

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.core.backend import (
    LOCALISATION_SPEED,
    SCAN_BEAMS,
    SCAN_RANGE,
    Backend,
    RobotState,
    Scan,
)
from kinfeas.core.spatial import Array, integrate
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory, Number, measured
from kinfeas.sim2real.adapters.dynamics import shortened
from kinfeas.sim2real.adapters.timing import filled, pushed


class BaseNoise(Adapter):
    """Gaussian noise on the commanded base velocity, also on a base at rest.

    Args:
        linear: Standard deviation of the velocity along each planar axis, m/s.
        angular: Standard deviation of the turning rate, rad/s.
    """

    stream = ""  # keeps the random numbers of early versions, which had a single stream

    def __init__(
        self, backend: Backend, robot: Robot, *, linear: Number = 0.015, angular: Number = 0.015
    ) -> None:
        super().__init__(backend, robot, {"linear": linear, "angular": angular})

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist with noise and the joint targets."""
        noise = self.normal(3)
        noisy = twist.copy()
        noisy[:, :2] += noise[:, :2] * self.number("linear")
        noisy[:, 5:] += noise[:, 2:] * self.number("angular")
        return noisy, targets


class JointNoise(Adapter):
    """Gaussian noise on the measured joint positions, drawn for each measurement.

    Args:
        deviation: Standard deviation, rad or m.
    """

    def __init__(self, backend: Backend, robot: Robot, *, deviation: Number = 0.002) -> None:
        super().__init__(backend, robot, {"deviation": deviation})

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with noise on the joint positions."""
        noise = self.normal(state.joint_positions.shape[1]) * self.number("deviation")
        return measured(state, joint_positions=self.joints(state.joint_positions + noise))


class EeNoise(Adapter):
    """Gaussian noise on the measured EE pose in the base frame, drawn for each measurement.

    The joint positions stay exact, as if a camera measured the hand.

    Args:
        linear: Standard deviation of the position along each axis, m.
        angular: Standard deviation of the orientation about each axis, rad.
    """

    def __init__(
        self, backend: Backend, robot: Robot, *, linear: Number = 0.003, angular: Number = 0.005
    ) -> None:
        super().__init__(backend, robot, {"linear": linear, "angular": angular})
        self._chain = build_chain(robot)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with noise on the EE pose."""
        exact = state.ee_in_base
        if exact is None:
            exact = forward(self._chain, state.joint_positions)
        noise = self.normal(6)
        noise[:, :3] *= self.number("linear")
        noise[:, 3:] *= self.number("angular")
        return measured(state, ee_in_base=displaced(exact, noise))


class Localisation(Adapter):
    """Drift and jumps of the measured base pose, as of a particle filter in a map.

    The error is a random walk that is zero at the start of an episode; jumps draw a new error.
    Commands in map axes are executed in axes rotated by the error.

    Args:
        drift: Standard deviation in m of the walk along each axis after one second.
        turn_drift: Standard deviation in rad of the heading's walk after one second.
        jump: Standard deviation of the error along each axis after a jump, m.
        turn_jump: Standard deviation of the heading's error after a jump, rad.
        rate: Mean rate of jumps, 1/s.
    """

    def __init__(  # noqa: PLR0913 - the keys of the YAML
        self,
        backend: Backend,
        robot: Robot,
        *,
        drift: Number = 0.003,
        turn_drift: Number = 0.002,
        jump: Number = 0.015,
        turn_jump: Number = 0.01,
        rate: Number = 0.1,
    ) -> None:
        numbers = {"drift": drift, "turn_drift": turn_drift, "jump": jump, "turn_jump": turn_jump}
        super().__init__(backend, robot, {**numbers, "rate": rate})

    def on_reset(self, state: RobotState) -> Memory:
        """Return zero errors (x, y, yaw); `followed` tracks `error` at `LOCALISATION_SPEED`."""
        zero = np.zeros((len(state.base_pose), 3))
        return {"error": zero, "followed": zero}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist rotated by the heading's error, and the joint targets."""
        angle = self.memory["error"][:, 2]
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = twist.copy()
        turned[:, 0] = cosine * twist[:, 0] + sine * twist[:, 1]
        turned[:, 1] = cosine * twist[:, 1] - sine * twist[:, 0]
        return turned, targets

    def on_step(self, state: RobotState, dt: float) -> None:
        """Advance the random walk by `dt` seconds, or jump."""
        noise = self.normal(6)
        walk = noise[:, :3] * self._deviations("drift") * np.sqrt(dt)
        jumps = self.uniform(1) <= -np.expm1(-self.number("rate") * dt)
        jump = noise[:, 3:] * self._deviations("jump")
        error = np.where(jumps, jump, self.memory["error"] + walk)
        followed, longest = self.memory["followed"], np.array([[LOCALISATION_SPEED * dt]])
        change = error - followed
        straight = np.concatenate([change[:, :2], np.zeros_like(change[:, :1])], axis=1)
        turn = np.clip(change[:, 2:], -longest, longest)
        change = np.concatenate([shortened(straight, longest)[:, :2], turn], axis=1)
        self.remember(error=error, followed=followed + change)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with the erroneous base pose."""
        localised = state.localised
        if localised is None:
            localised = (state.true_state or state).base_pose
        base = self._displaced(state.base_pose, "error")
        return measured(state, base_pose=base, localised=self._displaced(localised, "followed"))

    def _displaced(self, pose: Array, name: str) -> Array:
        """Return poses, shape (n, 7), displaced by `error` or `followed` of the memory."""
        displacement = np.zeros((len(pose), 6))
        displacement[:, [0, 1, 5]] = self.memory[name]
        return displaced(pose, displacement)

    def _deviations(self, name: str) -> Array:
        """Return the deviations of x, y and yaw, shape (n, 3)."""
        metres, radians = self.number(name), self.number(f"turn_{name}")
        return np.concatenate([metres, metres, radians], axis=1)


class ScanNoise(Adapter):
    """Gaussian noise on the ranges of scans, lost beams, and late scans.

    Beams without a return stay so; lost ones read the longest range.

    Args:
        deviation: Standard deviation of a range, m.
        lost: Fraction of lost beams, 0-1, drawn for each scan.
        seconds: Delay, s, rounded to whole control periods.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        deviation: Number = 0.02,
        lost: Number = 0.01,
        seconds: Number = 0.1,
    ) -> None:
        numbers = {"deviation": deviation, "lost": lost, "seconds": seconds}
        super().__init__(backend, robot, numbers, Interval(ge=0.0, le=1.0))
        self._exact, self.scanner = backend.scanner, backend.scanner and self

    def on_reset(self, state: RobotState) -> Memory:
        """Return buffers without a scan: obstacles may be placed after the reset."""
        n = len(state.base_pose)
        slots = self.memory["scans"].shape[1] if self.memory else 1
        scans = np.full((n, slots, 2, SCAN_BEAMS), np.nan)
        return {"scans": scans, "delay": np.zeros(n, dtype=np.intp), "age": np.zeros(n)}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Store the scan before the step; return the command unchanged."""
        slots = round(self.ranges["seconds"].high / dt)
        if slots and self._exact is not None:
            now, before = self._exact.scan().ranges, self.memory["scans"]
            before = np.where(np.isnan(before), filled(now, before.shape[1]), before)
            delay: NDArray[np.intp] = np.rint(self.number("seconds")[:, 0] / dt).astype(np.intp)
            self.remember(scans=pushed(before, now, slots), delay=delay, age=delay * dt)
        return twist, targets

    def scan(self) -> Scan:
        """Return the delayed ranges with noise, and the age of the oldest."""
        assert self._exact is not None
        exact = self._exact.scan()
        scans, delay = self.memory["scans"], self.memory["delay"]
        rows, slots = np.arange(len(delay)), scans.shape[1]
        late = scans[rows, np.maximum(slots - delay, 0) % slots]
        ranges: Array = np.where(delay[:, np.newaxis, np.newaxis] > 0, late, exact.ranges)
        shape = ranges.shape
        noise = self.normal(2 * SCAN_BEAMS) * self.number("deviation")
        noisy = np.clip(ranges + noise.reshape(shape), 0.0, SCAN_RANGE)
        lost = self.uniform(2 * SCAN_BEAMS) <= self.number("lost")
        lost_or_far = lost.reshape(shape) | (ranges >= SCAN_RANGE)
        age = exact.age + float(self.memory["age"].max())
        return replace(exact, ranges=np.where(lost_or_far, SCAN_RANGE, noisy), age=age)


def displaced(pose: Array, by: Array) -> Array:
    """Return poses (n, 7) displaced `by` (n, 6), m and rad; a row of zeros changes no bit."""
    moved = np.any(by != 0.0, axis=1, keepdims=True)
    return np.where(moved, integrate(pose, by, 1.0), pose)
