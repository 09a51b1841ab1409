"""A robot in the PyBullet world that is commanded over a bus, in real time, as a real one is."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinfeas import registry
from kinfeas.backend import Grip, RobotState
from kinfeas.errors import KinfeasError
from kinfeas.evaluation.physics.joint_setpoints import JointSetpoints
from kinfeas.evaluation.physics.world import physics_config
from kinfeas.foreign import Blaming, package_of
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.sim.backend import PyBulletBackend
from kinfeas.sim.robot_urdf import PLANAR_JOINTS
from kinfeas.sim.stage import Stage, task_scene
from kinfeas.sim2real.drive_limits import from_drive, to_drive
from kinfeas.sim2real.fault import Fault
from kinfeas.sim2real.link import (
    BaseReading,
    Hosted,
    JointPath,
    JointReading,
    Orders,
    RobotLink,
)
from kinfeas.sim2real.metronome import Metronome
from kinfeas.spatial import Array, planar_pose
from kinfeas.tasks.task import Task

_CATCH_UP = 10  # ticks of physics in one period at most, when the machine is late
_LINGER = 2.0  # s for which a robot goes on whose bus has broken


@dataclass(frozen=True)
class Role:
    """How a robot is played.

    Attributes:
        rate: Ticks per second: the world moves on and is measured, Hz.
        command_timeout: Seconds without a command after which the base stops by itself.
        seconds: How long; without end if None.
    """

    rate: float = 100.0
    command_timeout: float = 0.25
    seconds: float | None = None


@dataclass(frozen=True)
class Played:
    """What came of it.

    Attributes:
        seconds: How long it lasted.
        base_commands: How many commands the base got.
        joint_commands: How many ways the arm's controllers got.
        timeouts: How often the base stopped by itself while it was commanded to move.
        period_p99: Length of a tick that one in a hundred exceeds, seconds.
        longest: The longest tick, seconds.
    """

    seconds: float
    base_commands: int
    joint_commands: int
    timeouts: int
    period_p99: float
    longest: float


class SimulatedRobot:
    """A robot that does what its orders say, whoever gives them."""

    def __init__(self, backend: PyBulletBackend, state: RobotState, role: Role) -> None:
        """Begin at rest.

        Args:
            backend: World that the robot stands in.
            state: Where it stands.
            role: How it is played.
        """
        self.base_commands = self.joint_commands = self.timeouts = 0
        self._backend, self._role, self._state = backend, role, state
        self._robot = backend.body.robot
        self._arm = [joint.name for joint in self._robot.arm]
        arm = dict(zip(self._arm, state.joint_positions[0].tolist(), strict=True))
        self._setpoints = JointSetpoints(arm)
        self._velocity, self._since = np.zeros(3), -math.inf
        self._grip: Grip | None = None
        self._lock = threading.Lock()

    def orders(self) -> Orders:
        """Return what takes its orders."""
        return Orders(self._drive, self._move, self._take_grip)

    def tick(self, dt: float) -> None:
        """Do for `dt` seconds what the orders say."""
        now = time.monotonic()
        with self._lock:
            if now - self._since > self._role.command_timeout:
                self.timeouts += bool(self._velocity.any())
                self._velocity = np.zeros(3)
            velocity, grip, self._grip = self._velocity, self._grip, None
            # The motors lead to a target in that time: as the way's end for one of 0.1 s.
            ahead = now + self._backend.physics.config.arm_horizon
            targets = self._setpoints.at(ahead)
        if grip is not None:
            self._backend.grip(grip, np.array([0]))
        joints = np.array([[targets[name] for name in self._arm]])
        pose, base = self._state.base_pose[0], self._robot.base
        twist = from_drive(base, pose, velocity, dt)[np.newaxis]
        self._state = self._backend.step(twist, joints, dt)

    def measure(self) -> tuple[BaseReading, JointReading]:
        """Return where base and joints are now.

        Raises:
            KinfeasError: If the world is gone.
        """
        with self._backend.physics.connected():
            return self._readings()

    def _drive(self, velocity: Array) -> None:
        with self._lock:
            self._velocity, self._since = velocity, time.monotonic()
            self.base_commands += 1

    def _move(self, path: JointPath) -> None:
        with self._lock:
            self._setpoints.follow(path, time.monotonic())
            self.joint_commands += 1

    def _take_grip(self, grip: Grip) -> None:
        with self._lock:
            self._grip = grip

    def _readings(self) -> tuple[BaseReading, JointReading]:
        body, stamp = self._backend.body, time.time()
        x, y, yaw = body.planar()
        twist = self._state.base_twist
        assert twist is not None
        velocity = to_drive(self._robot.base, self._state.base_pose[0], twist[0], 0.0)
        joints = {name: at for name, at in body.joints.items() if name not in PLANAR_JOINTS}
        states = body.physics.client.getJointStates(body.body, list(joints.values()))
        positions = dict(self._robot.fixed_joints)
        positions |= {name: one[0] for name, one in zip(joints, states, strict=True)}
        velocities = {name: one[1] for name, one in zip(joints, states, strict=True)}
        base = BaseReading(x, y, yaw, velocity, stamp)
        return base, JointReading(positions, velocities, stamp)


def robot_link(backend: str, robot: Robot, topics: str | None = None) -> RobotLink:
    """Return the robot's end of the bus of a backend.

    Args:
        backend: Entry-point name in the group kinfeas.backends.
        robot: Who is played.
        topics: Name or path of the file with its names on the bus; its own by default.

    Raises:
        KinfeasError: If the backend is unknown, on no bus or broken, or the names do not fit.
    """
    kind = registry.load("kinfeas.backends", backend)
    if not isinstance(kind, Hosted):
        raise KinfeasError(f"backend {backend!r} is on no bus that a robot can be played on")
    package = kind.__module__.partition(".")[0]
    with Blaming(f"backend {backend!r} fails in robot_link:", package):
        link = kind.robot_link(robot, topics)
    if not isinstance(link, RobotLink):
        must = "must return a RobotLink from robot_link"
        raise KinfeasError(f"backend {backend!r} {must}, not {type(link).__name__}")
    return link


def set_stage(
    robot: Robot,
    task: Task | None = None,
    scene: str | None = None,
    numbers: tuple[int, int] = (1, 0),
    *,
    gui: bool = False,
) -> tuple[PyBulletBackend, RobotState]:
    """Return a world and where the robot stands in it.

    Args:
        robot: Who is played.
        task: As in an episode of which; at the origin and at home by default.
        scene: What stands around without a task; a floor and nothing else by default.
        numbers: Seed and episode of the task.
        gui: Whether to show it in a window.

    Raises:
        KinfeasError: If PyBullet is not installed, the scene is unknown or broken, or something of
            it stands where the robot begins.
    """
    around = task_scene(task) if task else read_scene(scene) if scene is not None else None
    physics = physics_config(robot).world.physics
    backend = PyBulletBackend(robot, around, gui=gui, physics=physics)
    if task is None:
        origin = planar_pose(*np.zeros((3, 1)))
        state = backend.reset(origin, robot.home["home"][np.newaxis])
        if around is not None and not backend.free():
            touched = _in_the_way(backend, around)
            backend.close()
            raise KinfeasError(touched)
        return backend, state
    start = Stage(task, backend).sample(IkSolver(robot), np.random.default_rng(numbers))
    return backend, backend.reset(start.base_pose[np.newaxis], start.joint_positions[np.newaxis])


def _in_the_way(backend: PyBulletBackend, scene: Scene) -> str:
    """Return the sentence that names what a robot at the origin touches."""
    touched = backend.touched()
    things = backend.furniture.bodies if backend.furniture else {}
    bodies = {number: repr(name) for name, number in things.items()}
    names = sorted(bodies.get(one, "the floor") for one in touched.base | touched.arm)
    return (
        f"scene {scene.name}: robot {backend.body.robot.name!r} begins at the origin and would "
        f"touch {', '.join(names)} there"
    )


def play(
    player: SimulatedRobot, link: RobotLink, role: Role, on_ready: Callable[[], None]
) -> Played:
    """Play a robot on a bus until its time is over, or Ctrl-C, and return what came of it.

    Args:
        player: The robot.
        link: Its end of the bus; it is opened and closed here.
        role: How it is played.
        on_ready: Called once it listens.

    Raises:
        KinfeasError: If there is no bus, or it has broken. The robot goes on for a while then: who
            is connected to it still is. Also if a link from outside fails, at once.
    """
    with _blaming(link, "open"):
        link.open(player.orders())
    metronome, begin, broken = Metronome(1.0 / role.rate), time.monotonic(), None
    end = math.inf if role.seconds is None else begin + role.seconds
    try:
        on_ready()
        while time.monotonic() < end:
            readings = player.measure()
            with _blaming(link, "report"):
                link.report(*readings)
            ticks = round(metronome.wait() * role.rate)
            for _ in range(min(max(ticks, 1), _CATCH_UP)):
                player.tick(1.0 / role.rate)
            if broken is None and (broken := _fault(link)) is not None:
                end = time.monotonic() + _LINGER
    except KeyboardInterrupt:
        pass  # as a robot is switched off that has no end of its own
    finally:
        with _blaming(link, "close"):
            link.close()
    if broken is not None:
        raise KinfeasError(str(broken))
    timing = metronome.timing()
    seconds = time.monotonic() - begin
    counts = player.base_commands, player.joint_commands, player.timeouts
    return Played(seconds, *counts, timing.p99, timing.longest)


def _fault(link: RobotLink) -> Fault | None:
    try:
        with _blaming(link, "check"):
            link.check()
    except Fault as fault:
        return fault
    return None


def _blaming(link: RobotLink, method: str) -> Blaming:
    """Return the context of a call of one of its methods, in which what it raises names it."""
    return Blaming(f"robot link {type(link).__name__} fails in {method}:", package_of(link))
