"""Settings of physics worlds, and the division of control periods into physics steps."""

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import NotNegative, Positive


@dataclass(frozen=True)
class PhysicsConfig:
    """Numbers of a physics world."""

    # physics steps per second, rounded so that a control period has a whole number: 5 steps of 4 ms
    # at 50 Hz, 24 of 1/240 s at the 0.1 s of the analytic world
    rate: Annotated[float, Interval(gt=0.0, le=1e5)] = 240.0
    gravity: NotNegative = 9.81  # m/s^2
    # of the constraint solver in a physics step; MuJoCo needs only a few
    iterations: Annotated[int, Interval(ge=1, le=10_000)] = 50
    # force of the base's motors as a multiple of what its acceleration takes
    drive_reserve: Annotated[float, Interval(ge=1.0)] = 2.0
    # torque per newton of weight that turns the wheels over the floor, m: their distance from the
    # base's centre, about 0.2 m, times a friction of about 0.6
    wheel_grip: NotNegative = 0.12
    arm_horizon: Positive = 0.1  # seconds in which the arm reaches a target at rest
    finger_friction: NotNegative = 1.0  # friction coefficient of the fingers
    # distance at which the fingers touch an object, m; the soft pads are not in the URDFs
    finger_softness: NotNegative = 0.003
    grasp_stiffness: Positive = 3000.0  # of fingers and arm together, N/m
    grasp_damping: NotNegative = 30.0  # the same, N s/m
    grasp_limit: Positive = 80.0  # force at which a held object slips out of the hand, N

    def divide(self, dt: float) -> int:
        """Return the number of physics steps of a control period of `dt` seconds."""
        if not 0.0 < dt < math.inf:
            raise KinfeasError(f"the control period must be above 0 s and finite, not {dt:g}")
        return max(round(dt * self.rate), 1)
