"""Sub-goals, their tolerances, and the execution of motions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinfeas.core import spatial
from kinfeas.core.backend import Grip
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.quantities import Seconds, TimeScale
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

Frame = Literal["ee", "tip"]

GRASP_METRES = 0.005  # distance to the end of a sub-goal at which a gripper acts


@dataclass(frozen=True)
class SubgoalMotion:
    """One sub-goal of a motion sequence with its motion generator."""

    generator: MotionGenerator  # moves the frame; sub-goals may share one
    frame: Frame = "ee"  # moves the EE frame or the tool tip in the common gripper convention
    dwell: float = 0.0  # seconds that the EE rests after it, unless it is the last sub-goal
    grip: Grip | None = None  # command to the gripper at the end of the sub-goal
    name: str = ""  # name of the generator in errors; its class by default


@dataclass(frozen=True)
class ExecutionConfig:
    """Execution of motions by robots with inertia."""

    # speed of the EE motion as a fraction of the planned one; dwells keep their time
    time_scale: TimeScale = 1.0
    head_start: Seconds = 0.0  # seconds that the EE rests at first while the base moves already
    # motion seconds for which a sub-goal with a grip continues after the arrival, to bring the EE
    # within `GRASP_METRES` of its end
    grasp_settle_time: Seconds = 0.0
    # upper bound of the random extension of each episode's head start, seconds
    head_start_jitter: Seconds = 0.0
    # longest pause of motion and base, in seconds, while the arm moves to another configuration
    # that is further away than 0.15 s at full joint velocity
    arm_settle_timeout: Seconds = 0.0
    # response of the robots to commands; by default as their backend states it
    response: ResponseModel | None = None

    @property
    def late(self) -> bool:
        """Whether a response is set that is not immediate."""
        return self.response is not None and not self.response.immediate


def tool_pose(robot: Robot) -> Array:
    """Return the tool tip in the EE frame, shape (7,): x is the approach, y the finger axis."""
    x, y, z, w = robot.gripper_rotation
    return np.concatenate([robot.tool_tip, spatial.canonical(np.array([-x, -y, -z, w]))])
