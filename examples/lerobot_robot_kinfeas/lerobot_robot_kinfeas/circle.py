"""A teleoperator that leads the tool tip on circles, to try a recording without a person."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from kinfeas.control.execution import tool_pose
from kinfeas.core import spatial
from kinfeas.io.lerobot import EE, TWIST
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot


@TeleoperatorConfig.register_subclass("kinfeas_circle")
@dataclass
class KinfeasCircleConfig(TeleoperatorConfig):
    """Settings of the circle.

    Attributes:
        robot: Robot of kinfeas, whose home pose is on the circle.
        action: As of the robot.
        radius: Metres.
        period: Seconds for one turn.
        fps: Actions per second.
    """

    robot: str = "pr2"
    action: Literal["pose", "twist"] = "pose"
    radius: float = 0.3
    period: float = 20.0
    fps: float = 30.0


class KinfeasCircle(Teleoperator):
    """Leads the tool tip on a horizontal circle that begins at the home pose."""

    config_class = KinfeasCircleConfig
    name = "kinfeas_circle"
    is_connected = False
    is_calibrated = True

    def __init__(self, config: KinfeasCircleConfig) -> None:
        super().__init__(config)
        self.config, self._count = config, 0
        robot = load_robot(config.robot)
        home = forward(IkSolver(robot).chain, robot.home["home"][np.newaxis])[0]
        self._start = spatial.compose(home, tool_pose(robot))

    @property
    def action_features(self) -> dict[str, type]:
        """Pose of the tool tip, or twist of the EE."""
        return dict.fromkeys({"pose": EE, "twist": TWIST}[self.config.action], float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    def calibrate(self) -> None:
        """Do nothing."""

    configure = calibrate

    def connect(self, calibrate: bool = True) -> None:
        """Begin at the home pose."""
        self._count, self.is_connected = 0, True

    def disconnect(self) -> None:
        """End."""
        self.is_connected = False

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, Any]:
        """Return the action of the next frame."""
        self._count += 1
        speed, config = 2.0 * np.pi / self.config.period, self.config
        angle = speed * self._count / config.fps
        if config.action == "twist":
            linear = config.radius * speed * np.array([np.cos(angle), np.sin(angle), 0.0])
            values = np.concatenate([linear, np.zeros(3)])
        else:
            values = self._start.copy()
            values[:2] += config.radius * np.array([np.sin(angle), 1.0 - np.cos(angle)])
        return dict(zip(self.action_features, values.tolist(), strict=True))
