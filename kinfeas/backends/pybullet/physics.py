"""A PyBullet world of its own: connection, time step, and the state that a reset returns to."""

import math
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from kinfeas.backends.pybullet.complaints import complaint, remarks, unread_mesh
from kinfeas.backends.pybullet.screen import check_screen
from kinfeas.backends.pybullet.silence import overhear, silence
from kinfeas.config import Interval
from kinfeas.config.quantities import NotNegative, Positive
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, relative

ROOT = -1
"""PyBullet's index of a body's root link."""

_AWAY = 1000.0
"""Height at which there is nothing to touch, metres."""

_DISTANCE, _YAW, _PITCH, _HEIGHT = 3.2, 50.0, -30.0, 0.6
"""How the window looks at a robot: metres, degrees, degrees, and metres above the floor."""


@dataclass(frozen=True)
class PhysicsConfig:
    """Numbers of the PyBullet world.

    Attributes:
        rate: Physics steps per second, about: a control period holds a whole number of them, so
            that 50 Hz makes 5 steps of 4 ms and the 0.1 s of the analytic world 24 of 1/240 s.
        gravity: m/s^2.
        iterations: Of the constraint solver in a step.
        drive_reserve: How much stronger the base's motors are than its acceleration takes, to bear
            the swings of the arm and what it pulls.
        wheel_grip: Torque for each newton of weight that turns wheels over the floor, m: their
            distance from the middle of the base, about 0.2 m, times a friction of about 0.6.
        arm_horizon: Seconds in which the arm reaches a target, to stand still there.
        finger_friction: Coefficient at the fingers.
        finger_softness: How near the fingers must be to something to touch it with the soft pads
            that the URDFs lack, m.
        grasp_stiffness: With which the hand holds, N/m: that of the fingers and the arm together.
        grasp_damping: The same, N s/m.
        grasp_limit: Force at which a held object slips out of the hand, N.
    """

    rate: Annotated[float, Interval(low=0.0, high=1e5, open_low=True)] = 240.0
    gravity: NotNegative = 9.81
    iterations: Annotated[int, Interval(low=1, high=10_000)] = 50
    drive_reserve: Annotated[float, Interval(low=1.0)] = 2.0
    wheel_grip: NotNegative = 0.12
    arm_horizon: Positive = 0.1
    finger_friction: NotNegative = 1.0
    finger_softness: NotNegative = 0.003
    grasp_stiffness: Positive = 3000.0
    grasp_damping: NotNegative = 30.0
    grasp_limit: Positive = 80.0


class Physics:
    """One world; others in the same process know nothing of it.

    Attributes:
        config: Its numbers.
        client: PyBullet's functions, bound to this world.
        floor: Number of the body that is the floor.
        step_time: Duration of a physics step in seconds.
    """

    def __init__(self, config: PhysicsConfig, *, gui: bool = False) -> None:
        """Make a world that holds nothing but its floor.

        Args:
            config: Its numbers.
            gui: Whether to show it in a window.

        Raises:
            KinfeasError: If PyBullet is not installed, or no window can be opened.
        """
        self.config, self.client, self._gui = config, _connect(gui), gui
        # The panels hide most of the world. Without a window nothing happens.
        self.client.configureDebugVisualizer(self.client.COV_ENABLE_GUI, 0)
        self.client.setGravity(0.0, 0.0, -config.gravity)
        # Pairs in an order of their own, not in that of their history: a reset forgets everything.
        self.client.setPhysicsEngineParameter(
            numSolverIterations=config.iterations, deterministicOverlappingPairs=1
        )
        plane = self.client.createCollisionShape(self.client.GEOM_PLANE)
        self.floor: int = self.client.createMultiBody(0.0, plane)
        self.step_time = 0.0
        self._bodies: list[int] = []
        self._kept: int | None = None

    def load(self, urdf: Path, *, fixed: bool) -> int:
        """Return the number of a new body at the origin.

        Args:
            urdf: A file that `parse_urdf` has checked.
            fixed: Whether its root link stays where it is put.

        Raises:
            KinfeasError: If PyBullet cannot load it, or one of its meshes.
        """
        body, heard = self._load(urdf, urdf, fixed=fixed)
        sys.stderr.write(remarks(heard))
        return body

    def load_text(self, urdf: str, source: Path) -> int:
        """Return the number of a new body with a fixed root.

        Args:
            urdf: Content of a URDF file whose meshes go by their absolute paths.
            source: The file that it was made from, beside which its textures lie.

        Raises:
            KinfeasError: If PyBullet cannot load it, or one of its meshes.
        """
        self.client.setAdditionalSearchPath(str(source.absolute().parent))
        with tempfile.TemporaryDirectory() as temporary:
            path = Path(temporary) / "body.urdf"
            path.write_text(urdf, encoding="utf-8")
            body, heard = self._load(path, source, fixed=True)
        sys.stderr.write(heard)
        return body

    def links(self, body: int) -> dict[str, int]:
        """Return the indices of a body's links by name."""
        root, _ = self.client.getBodyInfo(body)
        infos = (self.client.getJointInfo(body, i) for i in range(self.client.getNumJoints(body)))
        return {root.decode(): ROOT, **{info[12].decode(): info[0] for info in infos}}

    def joints(self, body: int) -> dict[str, int]:
        """Return the indices of a body's moving joints by name, in order."""
        infos = (self.client.getJointInfo(body, i) for i in range(self.client.getNumJoints(body)))
        fixed = self.client.JOINT_FIXED
        return {info[1].decode(): info[0] for info in infos if info[2] != fixed}

    def link_pose(self, body: int, link: int) -> Array:
        """Return the world pose of a link's frame, shape (7,)."""
        if link == ROOT:
            return compose(self.mass_pose(body, ROOT), relative(IDENTITY, self._mass_in_root(body)))
        state = self.client.getLinkState(body, link, computeForwardKinematics=True)
        return np.concatenate(state[4:6])

    def mass_pose(self, body: int, link: int) -> Array:
        """Return the world pose of the frame in which a link's inertia is given, shape (7,)."""
        if link == ROOT:
            return np.concatenate(self.client.getBasePositionAndOrientation(body))
        state = self.client.getLinkState(body, link, computeForwardKinematics=True)
        return np.concatenate(state[0:2])

    def motion(self, body: int, link: int) -> tuple[Array, Array, Array]:
        """Return the pose (7,) of a link's inertia, and how it moves: m/s, rad/s, (3,) and (3,)."""
        if link == ROOT:
            linear, angular = self.client.getBaseVelocity(body)
            return self.mass_pose(body, ROOT), np.array(linear), np.array(angular)
        state = self.client.getLinkState(body, link, 1, 1)  # velocity, and where it is now
        return np.concatenate(state[0:2]), np.array(state[6]), np.array(state[7])

    def place(self, body: int, pose: Array) -> None:
        """Put the root link of a body at rest at a world pose, shape (7,)."""
        # PyBullet means the frame of the inertia.
        mass_pose = compose(pose, self._mass_in_root(body))
        self.client.resetBasePositionAndOrientation(body, mass_pose[:3], mass_pose[3:])
        self.client.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3)

    def divide(self, dt: float) -> int:
        """Return how many physics steps a control period has, and set their duration.

        Raises:
            KinfeasError: If `dt` is not above 0 and finite.
        """
        if not 0.0 < dt < math.inf:
            raise KinfeasError(f"the control period must be above 0 s and finite, not {dt:g}")
        steps = max(round(dt * self.config.rate), 1)
        if dt / steps != self.step_time:
            self.step_time = dt / steps
            self.client.setTimeStep(self.step_time)
        return steps

    def advance(self) -> None:
        """Let a physics step pass."""
        self.client.stepSimulation()

    def look_at(self, base_pose: Array) -> None:
        """Turn the window, if there is one, to a robot whose base has a pose of shape (7,)."""
        if self._gui:
            self.client.resetDebugVisualizerCamera(
                _DISTANCE, _YAW, _PITCH, [*base_pose[:2], _HEIGHT]
            )

    def keep(self) -> None:
        """Remember the whole world for `rewind`; no body may be added after that."""
        self._kept = self.client.saveState()

    def rewind(self) -> None:
        """Return to what `keep` remembered, contacts and all."""
        # What touches would keep its impulses, or its place among other contacts, wherever it goes:
        # the corners that something lies on, or a robot at a wall.
        for number, body in enumerate(self._bodies):
            place = [0.0, 0.0, _AWAY * (number + 1.0)]
            self.client.resetBasePositionAndOrientation(body, place, IDENTITY[3:])
        self.client.performCollisionDetection()
        self.client.restoreState(self._kept)

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Return a context in which PyBullet's errors are sentences, and a world may be gone.

        Raises:
            KinfeasError: If PyBullet fails, as it does once its window is closed.
        """
        try:
            yield
        except self.client.error as error:
            raise KinfeasError(f"PyBullet fails, or its window was closed: {error}") from error

    def close(self) -> None:
        """End the world; it may be called twice, and nothing else after it."""
        self.client.leave()

    def _load(self, urdf: Path, source: Path, *, fixed: bool) -> tuple[int, str]:
        """Return the number of a new body, and what PyBullet said; errors name `source`."""
        client = self.client
        flags = client.URDF_USE_INERTIA_FROM_FILE | client.URDF_MAINTAIN_LINK_ORDER
        try:
            with overhear() as heard:
                body: int = client.loadURDF(str(urdf), useFixedBase=fixed, flags=flags)
        except client.error as error:
            reason = complaint(heard.getvalue()) or str(error)
            raise KinfeasError(f"{source}: PyBullet cannot load it: {reason}") from error
        if mesh := unread_mesh(heard.getvalue()):
            raise KinfeasError(
                f"{source}: PyBullet finds no triangles in the mesh {mesh!r}; binary STL, OBJ and "
                "DAE files are allowed"
            )
        self._bodies.append(body)
        return body, heard.getvalue()

    def _mass_in_root(self, body: int) -> Array:
        return np.concatenate(self.client.getDynamicsInfo(body, ROOT)[3:5])


def _connect(gui: bool) -> Any:
    try:
        with silence():
            import pybullet
            from pybullet_utils.bullet_client import BulletClient
    except ImportError as error:
        raise KinfeasError(
            "the PyBullet world needs Python 3.11: there is no PyBullet for later versions"
        ) from error
    if gui:
        check_screen()

    class Client(BulletClient):  # type: ignore[misc]  # it has no types
        def __getattr__(self, name: str) -> Any:
            # It binds functions anew at each use, and a physics step uses thirty.
            self.__dict__[name] = found = super().__getattr__(name)
            return found

        def leave(self) -> None:
            # What is bound to this connection must not reach the next one of the same number.
            if self.isConnected():
                self.disconnect()
            self.__dict__.clear()
            self._client = -1

    try:
        with silence():
            return Client(pybullet.GUI if gui else pybullet.DIRECT)
    except pybullet.error as error:
        raise KinfeasError(f"PyBullet opens no world: {error}") from error
