"""Backends that move robots: the contract, and protocols for the optional abilities of backends."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.pose_kernels import obstacles_are_finite
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array

Grip = Literal["close", "open"]
"""Commands of a gripper."""


@dataclass(frozen=True)
class RobotState:
    """Measured state of n robots.

    Attributes:
        base_pose: World pose of the base frame, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        base_twist: World twist of the base, shape (n, 6), m/s and rad/s, where it is measured.
        joint_velocities: Velocities of the arm joints, shape (n, j), where they are measured.
        age: Seconds since the oldest part was measured, shape (n,), if known.
        ee_in_base: EE pose in the base frame, shape (n, 7), where it differs from the kinematics.
        true_state: True state of a simulator whose sensors have errors.
    """

    base_pose: Array
    joint_positions: Array
    base_twist: Array | None = None
    joint_velocities: Array | None = None
    age: Array | None = None
    ee_in_base: Array | None = None
    true_state: "RobotState | None" = None


class Backend(Protocol):
    """Moves n robots; real robots have n = 1."""

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Put robots at rest and return the state of all n.

        Args:
            base_pose: World pose of the base, shape (m, 7).
            joint_positions: Arm joints, shape (m, j).
            env_ids: Indices of the m robots to reset; all n by default.
        """
        ...

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Command all n robots for `dt` seconds and return the measured state.

        Args:
            base_twist: World twist of the base, shape (n, 6), m/s and rad/s.
            joint_targets: Joint positions to reach, shape (n, j), radians or metres.
            dt: Seconds.
        """
        ...

    def close(self) -> None:
        """Free the resources; further calls do nothing."""
        ...


class BackendWrapper:
    """A backend around another one, `backend`: the base class of adapters and guards."""

    backend: Backend


@runtime_checkable
class Stochastic(Protocol):
    """A backend or adapter that draws random numbers.

    Equal seeds give equal draws of an episode in any batch.
    """

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Begin new episodes with one seed each, shape (m,), in the m `env_ids`."""
        ...


@runtime_checkable
class SupportsGripper(Protocol):
    """A backend or adapter whose robots have grippers."""

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Begin to close or to open the grippers of the m robots `env_ids`."""
        ...


@runtime_checkable
class SupportsDynamics(Protocol):
    """A simulated backend whose robots can have other masses, frictions and motors."""

    def scale_dynamics(
        self, mass: Array, friction: Array, motor_gain: Array, env_ids: NDArray[np.intp]
    ) -> None:
        """Multiply masses and frictions of robots, and gains of their arms' motors, shape (m,).

        Earlier factors of the m robots `env_ids` no longer apply. Motors keep their largest forces.
        """
        ...


@runtime_checkable
class NeedsAbility(Protocol):
    """An adapter for some backends only."""

    def check_backend(self) -> None:
        """Raise KinfeasError if the wrapped backend lacks an ability."""
        ...


@dataclass(frozen=True)
class ObstacleDistances:
    """Obstacles near the bases of n robots, k places each; unused places are at infinity.

    Attributes:
        closest_point: Point of the base closest to the obstacle, in the base frame, shape
            (n, k, 2), metres.
        normal: Horizontal part of the unit vector from there to the obstacle, in the base frame,
            shape (n, k, 2).
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


@runtime_checkable
class SupportsObstacleDistances(Protocol):
    """A backend or adapter that measures distances to obstacles."""

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return obstacles closer than `within` metres to the bases, without grasped objects."""
        ...


@runtime_checkable
class SupportsSolids(Protocol):
    """A simulated backend with solids around its robots.

    Attributes:
        solids: Solids of all n robots.
    """

    solids: MovingSolids

    def place_solids(self, solids: Solids | None, env_ids: NDArray[np.intp]) -> None:
        """Put solids around the m robots `env_ids` after their reset; None for none."""
        ...


SCAN_BANDS = ((0.0, 0.35), (0.35, 1.5))
"""Lowest and highest z of the bands of a scan, metres: the height of lasers, and that above."""

SCAN_BEAMS, SCAN_RANGE = 64, 3.0
"""Beams of a band, and their longest range in metres."""


@runtime_checkable
class SupportsScan(Protocol):
    """A backend or adapter that measures ranges around the bases."""

    def scan(self) -> Array:
        """Return the ranges in `SCAN_BANDS`, shape (n, 2, `SCAN_BEAMS`), metres.

        Beam i has the angle -pi + 2 pi i / `SCAN_BEAMS` to the base's heading. Ranges are at most
        `SCAN_RANGE`.
        """
        ...


@dataclass(frozen=True)
class MeasuredScan:
    """A scan by the sensors of one robot.

    Attributes:
        ranges: As in `SupportsScan`, shape (1, 2, `SCAN_BEAMS`); blind beams are `SCAN_RANGE`.
        blind: Whether no sensor covers a beam, shape (`SCAN_BEAMS`,).
        age: Age of the oldest measurement in it, seconds.
    """

    ranges: Array
    blind: NDArray[np.bool_]
    age: float


@runtime_checkable
class SupportsMeasuredScan(SupportsScan, Protocol):
    """A backend of one robot whose scan may be old or blind."""

    def measured_scan(self) -> MeasuredScan:
        """Return the newest scan."""
        ...


@dataclass(frozen=True)
class Contacts:
    """Contacts of one robot with its surroundings.

    A contact is a triple: link of the robot, other body and link of that body, by the numbers of
    the backend.

    Attributes:
        base: Contacts of links that the arm does not carry.
        arm: Contacts of the links of arm and hand.
    """

    base: frozenset[tuple[int, int, int]]
    arm: frozenset[tuple[int, int, int]]


@runtime_checkable
class SupportsContacts(Protocol):
    """A backend that measures contacts."""

    def contacts(self, env_id: int) -> Contacts:
        """Return the current contacts of a robot, except with the grasped link and the floor."""
        ...


@runtime_checkable
class BatchLimited(Protocol):
    """A backend or filter whose robots cost memory or time: a process has at most `max_batch`."""

    max_batch: int


@runtime_checkable
class RealTimeBackend(Protocol):
    """A backend whose robot moves in real time: a real robot, or a simulator process.

    `reset` cannot move the robot: it returns its state. `step` sends the command, waits for the end
    of the control period and returns the newest measurement.
    """

    def read(self) -> RobotState:
        """Return the newest measurement, with its age."""
        ...

    def stop(self) -> None:
        """Command zero base velocity and hold the arm; callable at any time, repeatedly."""
        ...


@runtime_checkable
class ArmLimited(Protocol):
    """A backend that controls the velocity of the arm toward its targets."""

    def limit_arm(self, velocity: Array) -> None:
        """Limit the velocities of the arm joints; shape (j,), rad/s or m/s."""
        ...


@runtime_checkable
class Resumable(Protocol):
    """A backend or adapter whose whole state can be saved as arrays."""

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state of all n robots by name."""
        ...

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Restore the state of a snapshot and return the measured state."""
        ...


def build_backend(name: str, parameters: Mapping[str, object], **offered: object) -> Backend:
    """Return a backend by its entry point and the keyword parameters of its constructor.

    Objects of the run, such as `robot`, are `offered`: passed on if the constructor names them.

    Raises:
        KinfeasError: If the backend is unknown, or a parameter is wrong or offered by the run.
    """
    factory = registry.load("kinfeas.backends", name)
    known = inspect.signature(factory).parameters if callable(factory) else {}
    given = {key: value for key, value in offered.items() if key in known}
    for key in given.keys() & parameters.keys():
        raise KinfeasError(f"backend {name!r}: the run sets the parameter {key!r}")
    backend: Backend = registry.build("kinfeas.backends", name, {**given, **parameters})
    return backend


def build_simulator(name: str, parameters: Mapping[str, object], **offered: object) -> Backend:
    """Return a simulated backend, for programs without guards; otherwise as `build_backend`.

    Raises:
        KinfeasError: Also if the backend moves a robot in real time; its class is not called.
    """
    factory = registry.load("kinfeas.backends", name)
    real_time = isinstance(factory, type) and issubclass(factory, RealTimeBackend)
    if not real_time:
        backend = build_backend(name, parameters, **offered)
        if not isinstance(backend, RealTimeBackend):
            return backend
        backend.close()
    raise KinfeasError(f"backend {name!r} is for deployment; only simulators are possible here")
