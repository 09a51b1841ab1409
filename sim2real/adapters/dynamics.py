"""Dynamics of base and arm: limits, lag, and other masses, frictions and motors."""

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.sim2real.adapters.adapter import Adapter, Memory, Number

_POSITIVE, _FACTORS = Interval(gt=0.0), Interval(ge=0.1, le=10.0)


class AccelerationLimit(Adapter):
    """Limits of the base's acceleration and, optionally, jerk.

    Linear limits hold for the norm of the planar vector. With a jerk limit the acceleration
    decreases in time to reach the commanded velocity without overshoot.

    Args:
        linear: Maximum planar acceleration, m/s^2; by default the robot's.
        angular: Maximum angular acceleration, rad/s^2; by default the robot's.
        linear_jerk: Maximum planar jerk, m/s^3; none by default.
        angular_jerk: Maximum angular jerk, rad/s^3; none by default.
    """

    late = True

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        linear: Number | None = None,
        angular: Number | None = None,
        linear_jerk: Number | None = None,
        angular_jerk: Number | None = None,
    ) -> None:
        limits = {
            "linear": robot.base.max_acceleration if linear is None else linear,
            "angular": robot.base.max_rotation_acceleration if angular is None else angular,
        }
        jerks = {"linear_jerk": linear_jerk, "angular_jerk": angular_jerk}
        limits |= {name: jerk for name, jerk in jerks.items() if jerk is not None}
        super().__init__(backend, robot, limits, _POSITIVE)
        limited = ResponseModel(
            acceleration=self.mean("linear"),
            rotation_acceleration=self.mean("angular"),
            jerk=self.mean("linear_jerk") or None,
            rotation_jerk=self.mean("angular_jerk") or None,
        )
        self.response = backend.response.within(limited)

    def on_reset(self, state: RobotState) -> Memory:
        """Return zero velocity and acceleration."""
        rest = np.zeros((len(state.base_pose), 6))
        return {"velocity": rest, "acceleration": rest}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the velocity that the base reaches by the end of the period."""
        velocity, acceleration = self.memory["velocity"], self.memory["acceleration"].copy()
        target = (twist - velocity) / dt
        for part, name in ((slice(0, 3), "linear"), (slice(3, 6), "angular")):
            acceleration[:, part] = self._limited(target[:, part], acceleration[:, part], name, dt)
        # Rounding must not change a command within the limits.
        reached = np.where(acceleration == target, twist, velocity + acceleration * dt)
        self.remember(velocity=reached, acceleration=acceleration)
        return reached, targets

    def _limited(self, target: Array, before: Array, name: str, dt: float) -> Array:
        """Return the feasible acceleration nearest to the target, shape (n, 3)."""
        largest = self.number(name)
        if f"{name}_jerk" not in self.ranges:
            return shortened(target, largest)
        jerk = self.number(f"{name}_jerk")
        # Reducing an acceleration a to zero in steps changes the velocity by a (a / jerk + dt) / 2.
        half = 0.5 * jerk * dt
        fading = np.sqrt(half * half + 2.0 * jerk * length(target) * dt) - half
        change = shortened(target, np.minimum(largest, fading)) - before
        return shortened(before + shortened(change, jerk * dt), largest)


class VelocityClamp(Adapter):
    """Limits of the velocities of base and arm.

    A joint whose target is too far continues toward it in the next periods.

    Args:
        linear: Maximum planar velocity, m/s; by default the robot's.
        angular: Maximum turning rate, rad/s; by default the robot's.
        joints: Fraction of each joint's maximum velocity, above 0.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        linear: Number | None = None,
        angular: Number | None = None,
        joints: Number = 1.0,
    ) -> None:
        limits = {
            "linear": robot.base.max_velocity if linear is None else linear,
            "angular": robot.base.max_rotation if angular is None else angular,
            "joints": joints,
        }
        super().__init__(backend, robot, limits, _POSITIVE)

    def on_reset(self, state: RobotState) -> Memory:
        """Return the joint positions."""
        return {"joints": state.joint_positions}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the command within the limits."""
        clamped = twist.copy()
        clamped[:, :3] = shortened(twist[:, :3], self.number("linear"))
        clamped[:, 3:] = shortened(twist[:, 3:], self.number("angular"))
        before = self.memory["joints"]
        change = joint_displacement(self.robot, before, targets)
        longest = self.robot.max_joint_velocity * self.number("joints") * dt
        clipped = self.joints(before + np.clip(change, -longest, longest))
        joints = np.where(np.abs(change) <= longest, targets, clipped)
        self.remember(joints=joints)
        return clamped, joints


class JointLimitClamp(Adapter):
    """Joint targets clipped to the soft limits of the arm.

    Args:
        margin: Distance from the limits, rad or m; at most half a joint's range.
    """

    def __init__(self, backend: Backend, robot: Robot, *, margin: Number = 0.0) -> None:
        super().__init__(backend, robot, {"margin": margin})
        self._lower, self._upper = robot.joint_limits
        half = float((self._upper - self._lower).min()) / 2.0
        if self.ranges["margin"].high > half:
            raise ValueError(f"margin is {margin}, at most {half:.4g} is half a joint's range")

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, and the joint targets within the limits."""
        margin = self.number("margin")
        return twist, np.clip(targets, self._lower + margin, self._upper - margin)


class ActuatorLag(Adapter):
    """First-order lag of the base's velocity and the joint positions.

    The base is commanded its mean velocity of a control period, so that the path does not depend
    on the control rate.

    Args:
        base: Time constant of the base's velocity, s.
        arm: Time constant of the joint positions, s.
    """

    late = True

    def __init__(
        self, backend: Backend, robot: Robot, *, base: Number = 0.1, arm: Number = 0.02
    ) -> None:
        super().__init__(backend, robot, {"base": base, "arm": arm})
        lag = ResponseModel(base_lag=self.mean("base"), arm_lag=self.mean("arm"))
        self.response = backend.response.within(lag)

    def on_reset(self, state: RobotState) -> Memory:
        """Return zero velocity and the joint positions."""
        joints = state.joint_positions
        return {"velocity": np.zeros((len(joints), 6)), "joints": joints}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the mean velocity, and the joint positions at the end of the period."""
        # The fractions of the step responses that are left after the period, shape (n, 1).
        base, arm = (
            np.exp(-dt / np.where(time > 0.0, time, 1.0)) * (time > 0.0)
            for time in (self.number("base"), self.number("arm"))
        )
        behind = self.memory["velocity"] - twist
        mean = twist + behind * (self.number("base") * (1.0 - base) / dt)
        remaining = joint_displacement(self.robot, targets, self.memory["joints"]) * arm
        joints = self.joints(targets + remaining)
        self.remember(velocity=twist + behind * base, joints=joints)
        return mean, joints


class DomainRandomisation(Adapter):
    """A robot whose dynamics differ from its model; for worlds with physics.

    Args:
        mass: Factor on the masses and inertias of the robot's links.
        friction: Factor on friction coefficients.
        motor_gain: Factor on the gains of the arm's motors, whose largest forces stay.
    """

    needs = "dynamics"

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        mass: Number = 1.0,
        friction: Number = 1.0,
        motor_gain: Number = 1.0,
    ) -> None:
        numbers = {"mass": mass, "friction": friction, "motor_gain": motor_gain}
        super().__init__(backend, robot, numbers, _FACTORS)

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Reset the backend and change the dynamics of the new episodes."""
        state = super().reset(base_pose, joint_positions, env_ids)
        rows = np.arange(len(base_pose)) if env_ids is None else env_ids
        mass, friction, motor_gain = (self.number(name)[rows, 0] for name in self.ranges)
        assert self.dynamics is not None
        self.dynamics.scale_dynamics(mass, friction, motor_gain, rows)
        return state


def length(vector: Array) -> Array:
    """Return norms, shape (n, 3) -> (n, 1), bit-identical in batches of any size."""
    squares = vector * vector
    return np.sqrt(squares[:, 0:1] + squares[:, 1:2] + squares[:, 2:3])


def shortened(vector: Array, longest: Array) -> Array:
    """Return vectors, shape (n, 3), scaled down to a norm of at most `longest`, shape (n, 1)."""
    norm = length(vector)
    return np.where(norm > longest, vector * (longest / np.maximum(norm, 1e-300)), vector)
