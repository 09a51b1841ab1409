"""A simulated mobile manipulator as a LeRobot robot, and a teleoperator that needs no person."""

from lerobot_robot_kinfeas.circle import KinfeasCircle, KinfeasCircleConfig
from lerobot_robot_kinfeas.robot import Kinfeas, KinfeasConfig

__all__ = ["Kinfeas", "KinfeasCircle", "KinfeasCircleConfig", "KinfeasConfig"]
