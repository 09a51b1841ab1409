"""A LeRobot robot whose action is an EE pose or twist; the base moves so that the arm can."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from lerobot.robots import Robot, RobotConfig

from kinfeas.control.execution import tool_pose
from kinfeas.core import spatial
from kinfeas.io.lerobot import BASE, EE, TWIST
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from kinfeas.viz.live import DT, Episode


@RobotConfig.register_subclass("kinfeas")
@dataclass
class KinfeasConfig(RobotConfig):
    """Settings of the robot.

    Attributes:
        robot: Robot of kinfeas by name, or the path of its YAML.
        policy: Base policy: run folder, ONNX file or name.
        backend: `analytic`, `mujoco` or `pybullet`.
        scene: Scene by name or path, or `none`.
        filters: Command filters in order.
        action: Whether an action is a pose of the tool tip or a twist of the EE.
        fps: Actions per second of simulated time, at most 50; LeRobot's own by default.
        camera: Edge of the images of a camera behind the robot, pixels; 0 for none. MuJoCo only.
    """

    robot: str = "pr2"
    policy: str = "pretrained"
    backend: str = "analytic"
    scene: str = "none"
    filters: list[str] = field(default_factory=lambda: ["time_scaling"])
    action: Literal["pose", "twist"] = "pose"
    fps: float = 30.0
    camera: int = 0


class Kinfeas(Robot):
    """A simulated robot that advances by one frame with each action.

    Poses are x y z qx qy qz qw in the world frame, with qw >= 0 at first and no change of
    sign from one observation to the next; twists are linear, then angular,
    along world axes.
    """

    config_class = KinfeasConfig
    name = "kinfeas"
    is_calibrated = True

    def __init__(self, config: KinfeasConfig) -> None:
        super().__init__(config)
        if not 0.0 < config.fps <= 1.0 / DT:
            raise ValueError(f"fps must be above 0 and at most {1.0 / DT:g}, not {config.fps:g}")
        if config.camera and config.backend != "mujoco":
            raise ValueError("a camera needs backend=mujoco")
        self.config = config
        self.cameras = {"behind": None} if config.camera else {}  # LeRobot asks for their number
        self._names = {"pose": EE, "twist": TWIST}[config.action]
        self._episode: Episode | None = None
        self._due = 0.0

    @property
    def observation_features(self) -> dict[str, Any]:
        """Poses of the tool tip and of the base, and images."""
        size = (self.config.camera, self.config.camera, 3)
        return dict.fromkeys((*EE, *BASE), float) | dict.fromkeys(self.cameras, size)

    @property
    def action_features(self) -> dict[str, type]:
        """Pose of the tool tip, or twist of the EE."""
        return dict.fromkeys(self._names, float)

    @property
    def is_connected(self) -> bool:
        """Whether the simulation runs."""
        return self._episode is not None

    def calibrate(self) -> None:
        """Do nothing."""

    configure = calibrate

    def connect(self, calibrate: bool = True) -> None:
        """Compile and begin a simulation, with the base at the origin and the arm at home."""
        config, robot = self.config, load_robot(self.config.robot)
        scene = None if config.scene == "none" else read_scene(config.scene)
        self._episode = Episode(
            robot, config.policy, scene, filters=config.filters, backend=config.backend
        )
        for _ in range(3):  # compiles the kernels, for which LeRobot's loops would wait
            ahead = spatial.planar_pose(0.1, 0.0, 0.0)
            self._episode.step(spatial.compose(self._episode.ee_pose, ahead))
        self._episode.restart()
        self._tool = tool_pose(robot)
        self._target, self._due = self._episode.ee_pose, 0.0
        self._poses = np.stack([spatial.IDENTITY, spatial.IDENTITY])
        if config.camera:
            import mujoco

            engine = self._episode.backend.model.engine
            self._renderer = mujoco.Renderer(engine, config.camera, config.camera)
            self._view = mujoco.MjvCamera()
            self._view.distance, self._view.elevation = 3.0, -25.0

    def disconnect(self) -> None:
        """End the simulation."""
        if self._episode is not None:
            self._episode.close()
            self._episode = None
            if self.cameras:
                self._renderer.close()

    def get_observation(self) -> dict[str, Any]:
        """Return the state after the last action."""
        episode = self._running()
        tool = spatial.compose(episode.ee_pose, self._tool)
        poses = np.stack([tool, episode.base_pose])
        pairs = np.stack([self._poses[:, 3:], poses[:, 3:]], axis=1)  # IDENTITY first: qw >= 0
        poses[:, 3:] = spatial.continuous(pairs)[:, 1]
        self._poses = poses
        observation: dict[str, Any] = dict(zip((*EE, *BASE), poses.ravel().tolist(), strict=True))
        return observation | {name: self._image() for name in self.cameras}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move for one frame, and return the action; the EE holds its pose without a valid one."""
        episode = self._running()
        values = np.array([float(action.get(name, np.nan)) for name in self._names])
        twist = self.config.action == "twist"
        if not twist and np.isfinite(values).all() and np.linalg.norm(values[3:]) > 1e-3:
            values[3:] /= np.linalg.norm(values[3:])
            self._target = spatial.compose(values, spatial.relative(spatial.IDENTITY, self._tool))
        self._due += 1.0 / self.config.fps
        while self._due > DT / 2.0:
            self._due -= DT
            if twist:
                episode.controller.set_twist(values)
                self._target = episode.loop.desired[0]  # no new target: the twist moves the EE
            episode.step(self._target)
        return action

    def _image(self) -> Any:
        """Return the image of a camera that follows the base, shape (edge, edge, 3)."""
        episode, view = self._running(), self._view
        view.lookat = episode.base_pose[:3] + np.array([0.0, 0.0, 0.8])
        view.azimuth = np.degrees(spatial.yaw(episode.base_pose)) + 30.0
        self._renderer.update_scene(episode.backend.sims.data(0), view)
        return self._renderer.render()

    def _running(self) -> Episode:
        if self._episode is None:
            raise ConnectionError(f"{self} is not connected")
        return self._episode
