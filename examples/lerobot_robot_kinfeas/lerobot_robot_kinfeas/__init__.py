"""A simulated mobile manipulator as a LeRobot robot, a teleoperator and a processor step."""

from lerobot_robot_kinfeas.chunk import RelativeChunk
from lerobot_robot_kinfeas.circle import KinfeasCircle, KinfeasCircleConfig
from lerobot_robot_kinfeas.robot import Kinfeas, KinfeasConfig

__all__ = ["Kinfeas", "KinfeasCircle", "KinfeasCircleConfig", "KinfeasConfig", "RelativeChunk"]
