"""A simulated robot with physics that listens to the topics of a real one, in real time."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from kinfeas.backends.physics.backend import PhysicsBackend
from kinfeas.config import PluginSpec, registry
from kinfeas.config.recipes import default_engine
from kinfeas.control.assemble import build_backend, with_adapters
from kinfeas.core.backend import Backend, BackendWrapper, Grip, RobotState, closed_on_error
from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.core.spatial import Array, planar_pose, yaw
from kinfeas.core.start import episode_rng
from kinfeas.envs.world import evaluation_world
from kinfeas.kinematics.drive import base_velocity, world_twist
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.scenes.scene import furniture_solids, read_scene
from kinfeas.sim2real.deploy.runtime import Signals
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading, Orders, RobotLink
from kinfeas.sim2real.link.rate import Clock, Rate
from kinfeas.tasks.task import Task

_CATCH_UP = 10  # simulation steps in one period at most, if the machine is late
_SCAN_RATE = 10.0  # Hz
_AT_ONCE = 1e-9  # s to a point at least; times are relative, since floats of an uptime are coarser
_LINGER = 2.0  # s that a robot continues without its bus


@dataclass(frozen=True)
class SimulationResult:
    """Statistics of a simulated robot."""

    seconds: float  # duration
    base_commands: int  # number of commands to the base
    joint_commands: int  # number of trajectories for the arm
    timeouts: int  # how often the base stopped for lack of commands
    dropped: int  # number of invalid messages, and of trajectories with unknown joints
    period_p99: float  # 99th percentile of the period of a simulation step, seconds
    longest: float  # longest period, seconds


class JointSetpoints:
    """Setpoints of joints over time, as trajectory controllers have them.

    A trajectory is a cubic spline from the present setpoint and velocity; it ends at rest. Between
    its points it does not overshoot.
    """

    def __init__(self, positions: Mapping[str, float]) -> None:
        self._paths = {
            name: CubicHermiteSpline([0.0, 1.0], np.array([at, at]), np.zeros(2))
            for name, at in positions.items()
        }
        self._starts = dict.fromkeys(positions, 0.0)

    def follow(self, path: JointPath, time: float) -> None:
        """Start a trajectory at a time in seconds; unknown joints are ignored.

        Points whose time has passed are left out, but the last one, which is reached at once.
        """
        kept = path.times >= _AT_ONCE
        kept[-1] = True
        times: Array = np.append(0.0, np.maximum(path.times[kept], _AT_ONCE))
        for column, name in enumerate(path.joints):
            if name in self._paths:
                before, now = self._paths[name], self._since_start(name, time)
                values = np.append(before(now), path.positions[kept, column])
                slopes = PchipInterpolator(times, values)(times, 1)
                slopes[0], slopes[-1] = before(now, 1), 0.0
                self._paths[name] = CubicHermiteSpline(times, values, slopes)
                self._starts[name] = time

    def at(self, time: float) -> dict[str, float]:
        """Return the setpoints at a time in seconds, by joint."""
        return {
            name: float(path(self._since_start(name, time))) for name, path in self._paths.items()
        }

    def _since_start(self, name: str, time: float) -> float:
        return float(np.clip(time - self._starts[name], 0.0, self._paths[name].x[-1]))


class SimulatedRobot:
    """A robot in a physics world that executes orders, and counts them as in `SimulationResult`.

    Adapters around the world change what it executes and measures.
    """

    def __init__(
        self,
        backend: Backend,
        state: RobotState,
        command_timeout: float = 0.25,
        clock: Clock | None = None,
    ) -> None:
        """Start at rest in a world and `state` from `spawn`; `clock` is the system's by default.

        After `command_timeout` seconds without a command the base stops.
        """
        self.base_commands = self.joint_commands = self.timeouts = self.dropped = 0
        self._timeout, self.clock = command_timeout, clock or Clock()
        self._backend, self._state, self._world = backend, state, world_of(backend)
        self._robot = self._world.robot
        self._arm = [joint.name for joint in self._robot.arm]
        arm = dict(zip(self._arm, state.joint_positions[0].tolist(), strict=True))
        self._setpoints = JointSetpoints(arm)
        self._velocity, self._commanded = np.zeros(3), -math.inf
        self._grip: Grip | None = None
        self._lock = threading.Lock()

    def orders(self) -> Orders:
        """Return the callbacks for commands."""
        return Orders(self._drive, self._move, self._take_grip, self._drop)

    def step(self, dt: float) -> None:
        """Execute the orders for `dt` seconds."""
        now = self.clock.monotonic()
        with self._lock:
            if now - self._commanded > self._timeout:
                self.timeouts += bool(self._velocity.any())
                self._velocity = np.zeros(3)
            velocity, grip, self._grip = self._velocity, self._grip, None
            # The motors reach a target after their horizon.
            targets = self._setpoints.at(now + self._world.config.arm_horizon)
        if grip is not None:
            self._world.grip(grip, np.array([0]))
        joints = np.array([[targets[name] for name in self._arm]])
        twist = world_twist(self._robot.base, self._state.base_pose, velocity[np.newaxis], dt)
        self._state = self._backend.step(twist, joints, dt)

    def measure(self) -> tuple[BaseReading, JointReading]:
        """Return the measurements of base and joints; raise KinfeasError if the world is gone."""
        joints, velocities = self._world.joint_motion()
        stamp, state = self.clock.wall(), self._state
        if state.age is not None:
            stamp -= float(state.age[0])
        if self._backend is not self._world:
            exact = np.array([joints[name] for name in self._arm])
            # Keeps the turns of continuous joints.
            shown = exact + joint_displacement(self._robot, exact, state.joint_positions[0])
            joints = {**joints, **dict(zip(self._arm, shown.tolist(), strict=True))}
        assert state.base_twist is not None
        velocity = base_velocity(self._robot.base, state.base_pose, state.base_twist, 0.0)[0]
        x, y = state.base_pose[0, :2].tolist()
        base = BaseReading(x, y, float(yaw(state.base_pose)[0]), velocity, stamp)
        return base, JointReading({**self._robot.fixed_joints, **joints}, velocities, stamp)

    def scan(self) -> Array:
        """Return the ranges around the robot, as in `RobotLink`."""
        scanner = self._backend.scanner
        assert scanner is not None
        return scanner.scan().ranges[0]

    def _drive(self, velocity: Array) -> None:
        with self._lock:
            self._velocity, self._commanded = velocity, self.clock.monotonic()
            self.base_commands += 1

    def _move(self, path: JointPath) -> None:
        with self._lock:
            self._setpoints.follow(path, self.clock.monotonic())
            self.joint_commands += 1
            self.dropped += not set(path.joints) <= set(self._arm)

    def _take_grip(self, grip: Grip) -> None:
        with self._lock:
            self._grip = grip

    def _drop(self) -> None:
        with self._lock:
            self.dropped += 1


def simulate(
    robot: SimulatedRobot,
    link: RobotLink,
    on_ready: Callable[[], None],
    frequency: float = 100.0,
    seconds: float = math.inf,
) -> SimulationResult:
    """Run a simulated robot for `seconds` or until a signal of `Signals`; return the statistics.

    Each second has `frequency` simulation steps and measurements.
    The link is opened and closed; `on_ready` is called once it receives commands. If the bus breaks
    the robot continues for 2 s, so that deployments can detect it, and an error is raised.
    """
    link.open(robot.orders())
    clock, dt = robot.clock, 1.0 / frequency
    start, rate, broken = clock.monotonic(), Rate(dt, clock), None
    end = start + seconds
    steps, scan_due = 0, start
    with closing(link), Signals() as signals:
        signals.noting = True
        on_ready()
        while signals.caught is None and clock.monotonic() < end:
            rate.wait()
            due = int((clock.monotonic() - start) * frequency + 1e-6)
            steps = max(steps, due - _CATCH_UP)
            while steps < due:
                robot.step(dt)
                steps += 1
            base, joints = robot.measure()
            ranges = None
            if (now := clock.monotonic()) >= scan_due - 0.5 * dt:
                ranges, scan_due = robot.scan(), max(scan_due + 1.0 / _SCAN_RATE, now)
            link.report(base, joints, ranges)
            robot.step(dt)  # ahead of time: commands that arrive during `wait` act on later steps
            steps += 1
            if broken is None:
                try:
                    link.check()
                except Fault as fault:
                    broken, end = fault, clock.monotonic() + _LINGER
    if broken is not None:
        raise broken
    timing = rate.timing()
    return SimulationResult(
        clock.monotonic() - start, robot.base_commands, robot.joint_commands, robot.timeouts,
        robot.dropped, timing.p99, timing.longest,
    )  # fmt: skip


def robot_link(backend: str, robot: Robot, topics: str | None = None) -> RobotLink:
    """Return the robot's end of the transport of a backend; arguments as in `RobotLink`."""
    kind = registry.load("kinfeas.backends", backend)
    if not hasattr(kind, "robot_link"):
        raise KinfeasError(f"backend {backend!r} has no transport for a simulated robot")
    return kind.robot_link(robot, topics)


def world_of(backend: Backend) -> PhysicsBackend:
    """Return the physics world within adapters."""
    while isinstance(backend, BackendWrapper):
        backend = backend.backend
    if not isinstance(backend, PhysicsBackend):
        raise KinfeasError(f"backend {backend.name!r} has no physics")
    return backend


def spawn(  # noqa: PLR0913 - the parts of a world
    robot: Robot,
    task: Task | None = None,
    scene: str | None = None,
    *,
    rng: np.random.Generator | None = None,
    engine: str | None = None,
    gui: bool = False,
    adapters: Sequence[PluginSpec] = (),
) -> tuple[Backend, RobotState]:
    """Return a world of an engine, by default the first installed, and the robot's state in it.

    The robot starts as in an episode of the task, which `rng` draws, or without a task at the
    origin of a scene, by default an empty floor; an object there raises KinfeasError. Adapters lie
    around the world, the first one innermost; `rng` also draws their numbers.
    """
    room, rng = read_scene(scene) if scene is not None else None, rng or episode_rng(0, 0)
    engine = engine or default_engine()
    parameters = evaluation_world(engine, robot.folder).backend_parameters
    backend = build_backend(engine, {**parameters, "gui": gui}, robot=robot, scene=room)
    with closed_on_error(backend):
        world = world_of(backend)
        outer = with_adapters(backend, adapters, robot)
        # From a copy, so that adapters do not change what the task draws.
        seeds = np.array([deepcopy(rng).integers(2**64, dtype=np.uint64)])
        outer.seed(seeds, np.array([0]))
        if task is not None:
            start = world.stage(task).sample(IkSolver(robot), rng)
            base, joints = start.base_pose, start.joint_positions
            state = outer.reset(base[np.newaxis], joints[np.newaxis])
            world.place_solids(start.solids, np.array([0]))
            return outer, state
        state = outer.reset(planar_pose(*np.zeros((3, 1))), robot.home["home"][np.newaxis])
        if room is not None:
            if touched := world.touched():
                names = ", ".join(map(repr, touched))
                raise KinfeasError(f"scene {room.name}: the robot would touch {names}")
            furniture = furniture_solids(room)  # for scans
            world.furniture = furniture.places
            world.place_solids(furniture, np.array([0]))
        return outer, state
