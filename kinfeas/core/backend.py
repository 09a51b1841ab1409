"""Backends that move robots: the contract, and the optional abilities of backends."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.pose_kernels import obstacles_are_finite
from kinfeas.core.response import ResponseModel
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array

Grip = Literal["close", "open"]
"""Commands of a gripper."""


LOCALISATION_SPEED = 0.05
"""Speed at which robots follow a jump of their localisation, m/s and rad/s."""


@dataclass(frozen=True)
class RobotState:
    """Measured state of n robots.

    Attributes:
        base_pose: World pose of the base frame, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        base_twist: World twist of the base, shape (n, 6), m/s and rad/s, where it is measured.
        joint_velocities: Velocities of the arm joints, shape (n, j), where they are measured.
        age: Seconds since the oldest part was measured, shape (n,), if known.
        ee_in_base: EE pose in the base frame, shape (n, 7), where it is not that of the kinematics.
        localised: Current base pose in the frame of a localisation with errors, shape (n, 7): it is
            not delayed, and follows jumps of the localisation at `LOCALISATION_SPEED`.
        true_state: True state of a simulator whose sensors have errors.
    """

    base_pose: Array
    joint_positions: Array
    base_twist: Array | None = None
    joint_velocities: Array | None = None
    age: Array | None = None
    ee_in_base: Array | None = None
    localised: Array | None = None
    true_state: "RobotState | None" = None


@dataclass(frozen=True)
class ObstacleDistances:
    """Obstacles near the bases of n robots, k for each; unused entries have an infinite distance.

    Attributes:
        closest_point: Point of the base closest to the obstacle, in the base frame, shape
            (n, k, 2), metres.
        normal: Horizontal part of the unit vector from that point to the obstacle, in the base
            frame, shape (n, k, 2).
        distance: Distance to the obstacle, shape (n, k), metres; negative in penetration, inf
            without an obstacle.
        closing_speed: Speed at which the obstacle moves towards that point, shape (n, k), m/s;
            negative if it moves away, None if it is not measured.

    Raises:
        ValueError: If a shape is wrong or a value is not a number.
    """

    closest_point: Array
    normal: Array
    distance: Array
    closing_speed: Array | None = None

    def __post_init__(self) -> None:
        """Check the values of outside backends."""
        shape, speed = self.distance.shape, self.closing_speed
        if len(shape) != 2 or {self.closest_point.shape, self.normal.shape} != {(*shape, 2)}:
            raise ValueError(
                "closest_point, normal and distance need the shapes (n, k, 2), (n, k, 2) and (n, k)"
            )
        if speed is not None and speed.shape != shape:
            raise ValueError("closing_speed must have the shape of distance")
        closing = np.zeros(shape[1]) if speed is None else speed
        numbers = self.closest_point, self.normal, self.distance, closing
        if not obstacles_are_finite(*numbers).all():
            raise ValueError(
                "closest_point, normal and closing_speed must be finite, and distance must be a "
                "number, or inf without an obstacle"
            )


SCAN_BANDS = ((0.0, 0.35), (0.35, 1.5))
"""Lowest and highest z of the bands of a scan, metres: heights of laser scanners, and above."""

SCAN_BEAMS, SCAN_RANGE = 64, 3.0
"""Beams of a band, and their longest range in metres."""


@dataclass(frozen=True)
class Scan:
    """Ranges around the bases of n robots.

    Attributes:
        ranges: In `SCAN_BANDS`, shape (n, 2, `SCAN_BEAMS`), metres, at most `SCAN_RANGE`. Beam i
            has the angle -pi + 2 pi i / `SCAN_BEAMS` to the base's heading.
        blind: Whether no sensor covers a beam, shape (`SCAN_BEAMS`,), for real robots; None if
            all are covered. Blind beams have the longest range.
        age: Seconds since the oldest part was measured.
    """

    ranges: Array
    blind: NDArray[np.bool_] | None = None
    age: float = 0.0


@dataclass(frozen=True)
class Contacts:
    """Contacts of one robot with its surroundings.

    A contact is a triple: link of the robot, other body and link of that body, by the numbers of
    the backend.
    """

    base: frozenset[tuple[int, int, int]]  # contacts of links that the arm does not carry
    arm: frozenset[tuple[int, int, int]]  # contacts of the links of arm and hand


@dataclass(frozen=True)
class StopCall:
    """A function with which another process stops the base.

    Attributes:
        path: Function `module:function`. It is called once, connects to the robot and returns a
            function without arguments that commands zero velocity. If this raises, it is called
            again.
        arguments: Keyword arguments of the first call, which must fit into JSON.
    """

    path: str
    arguments: Mapping[str, object] = field(default_factory=dict)


class Gripper(Protocol):
    """Grippers of n robots."""

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Begin to close or to open the grippers of the m robots `env_ids`."""


class Scanner(Protocol):
    """Range sensors of n robots."""

    def scan(self) -> Scan:
        """Return the newest ranges around the bases."""


class ObstacleSensor(Protocol):
    """Distances between bases and obstacles."""

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return obstacles closer than `within` metres to the bases, except the link to grasp."""


class ContactSensor(Protocol):
    """Contacts of robots with their surroundings."""

    def touching(self, env_id: int) -> Contacts:
        """Return a robot's contacts, except with the floor or of its arm with the link to grasp."""


class Dynamics(Protocol):
    """Simulated robots whose masses, frictions and motors can change."""

    def scale_dynamics(
        self, mass: Array, friction: Array, motor_gain: Array, env_ids: NDArray[np.intp]
    ) -> None:
        """Multiply masses and frictions of robots, and gains of their arms' motors, shape (m,).

        Earlier factors of the m robots `env_ids` no longer apply. Motors keep their largest forces.
        """


class Resumable(Protocol):
    """Robots whose whole state can be saved as arrays."""

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state of all n robots by name."""

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Restore the state of a snapshot and return the measured state."""


class Staging(Protocol):
    """A simulator that sets up the scenes of tasks."""

    def stage(self, task: Any) -> Any:
        """Return a `kinfeas.tasks.task.Task` that also places its objects in the simulator."""


class Backend(ABC):
    """Moves n robots; real robots have n = 1.

    Each optional ability is an object, which may be the backend itself, or None without it.

    Attributes:
        gripper: Grippers.
        scanner: Range sensors.
        obstacles: Distances to obstacles.
        solids: Solids around all n robots, set by `place_solids`.
        contacts: Contact sensors.
        dynamics: Masses, frictions and motors that can change.
        resumable: Saves and restores the whole state.
        staging: Sets up the scenes of tasks.
        real_time: The robot that moves in real time, or None in a simulation that waits for `step`.
        max_batch: Robots that a process should have at most, since each costs memory or time.
        response: Delays and limits between commands and measurements.
        arm_seconds: Duration of the cubic on which an arm moves to each joint target, from its
            present motion to rest; 0 if it reaches the target by the end of the period.
    """

    gripper: Gripper | None = None
    scanner: Scanner | None = None
    obstacles: ObstacleSensor | None = None
    solids: MovingSolids | None = None
    contacts: ContactSensor | None = None
    dynamics: Dynamics | None = None
    resumable: Resumable | None = None
    staging: Staging | None = None
    real_time: "RealTimeBackend | None" = None
    max_batch: int | None = None
    response: ResponseModel = ResponseModel()
    arm_seconds: float = 0.0

    @abstractmethod
    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Put robots at rest and return the state of all n.

        Args:
            base_pose: World pose of the base, shape (m, 7).
            joint_positions: Arm joints, shape (m, j).
            env_ids: Indices of the m robots to reset; all n by default.
        """

    @abstractmethod
    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Command all n robots for `dt` seconds and return the measured state.

        Args:
            base_twist: World twist of the base, shape (n, 6), m/s and rad/s.
            joint_targets: Joint positions to reach, shape (n, j), radians or metres.
            dt: Seconds.
        """

    @abstractmethod
    def close(self) -> None:
        """Free the resources; further calls do nothing."""

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:  # noqa: B027 - few need it
        """Seed the random numbers of new episodes, shape (m,), in the m `env_ids`.

        Equal seeds give equal numbers of an episode in any batch.
        """

    def place_solids(self, solids: Solids | None, env_ids: NDArray[np.intp]) -> None:
        """Put solids around the m robots `env_ids` after their reset; None for none."""
        if solids is not None:
            raise KinfeasError(f"backend {self.name} has no solids, which the task needs")

    def execution(self, execution: Any) -> Any:
        """Return an `ExecutionConfig` as changed by the adapters around the backend."""
        return execution

    @property
    def name(self) -> str:
        """Name of the innermost backend, for errors."""
        return type(self).__name__


class RealTimeBackend(Backend):
    """A backend whose robot moves in real time: a real robot, or a simulator process.

    `reset` cannot move the robot: it returns its state. `step` sends the command, waits for the end
    of the control period and returns the newest measurement.

    Attributes:
        prepare: Called while `step` waits, for work that needs no measurement; None for none.
    """

    prepare: Callable[[], None] | None = None

    @property
    def real_time(self) -> "RealTimeBackend":  # type: ignore[override]  # never replaced
        """The robot itself."""
        return self

    @abstractmethod
    def read(self) -> RobotState:
        """Return the newest measurement, with its age."""

    @abstractmethod
    def stop(self) -> None:
        """Command zero base velocity and hold the arm; callable at any time, repeatedly."""

    def limit_arm(self, velocity: Array) -> None:
        """Limit the joint velocities of the arm, (j,), rad/s or m/s, if commands contain them."""

    def silent_source(self, seconds: float) -> str:
        """Return which source sent no measurement for some seconds, as a clause; empty if none."""
        return ""

    def stop_call(self) -> StopCall | None:
        """Return the call with which another process stops the base; None if there is none."""
        return None


ABILITIES = tuple(Backend.__annotations__)
"""Names of the abilities and properties of a backend, which wrappers copy."""


class BackendWrapper(Backend):
    """A backend around another one, with its abilities: the base class of adapters and guards.

    Attributes:
        backend: The wrapped backend.
    """

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        for ability in ABILITIES:
            setattr(self, ability, getattr(backend, ability))

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Seed the random numbers of the wrapped backend."""
        self.backend.seed(seeds, env_ids)

    def place_solids(self, solids: Solids | None, env_ids: NDArray[np.intp]) -> None:
        """Put solids into the wrapped backend."""
        self.backend.place_solids(solids, env_ids)

    def execution(self, execution: Any) -> Any:
        """Return the execution as changed by the wrapped backend."""
        return self.backend.execution(execution)

    def close(self) -> None:
        """Close the wrapped backend."""
        self.backend.close()

    @property
    def name(self) -> str:
        """Name of the innermost backend."""
        return self.backend.name


@contextmanager
def closed_on_error(backend: Backend) -> Iterator[None]:
    """Close a backend if the block, which builds something around it, raises an exception."""
    with ExitStack() as opened:
        opened.callback(backend.close)
        yield
        opened.pop_all()
