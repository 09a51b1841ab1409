"""One PyBullet world: connection, time step, loading of URDFs, saved state, quiet output."""

import ctypes
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryFile
from typing import Any

import numpy as np

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, relative
from kinfeas.robots.elements import Element, parse_xml, read_xml

ROOT = -1
"""PyBullet's index of a body's root link."""

_AWAY = 1000.0  # m, vertical distance at which bodies have no contacts
_WINDOW_CAMERA = (3.2, 50.0, -30.0)  # m from the robot, degrees of yaw and pitch
_WINDOW_HEIGHT = 0.6  # m above the floor
_UNREAD_MESH = re.compile(r"cannot extract (?:mesh|anything)|issue extracting mesh")
_MESSAGE = re.compile(r"b3(?:Error|Warning|Printf)\[[^\]]*\]:\s*")
_TRIAL = "import os, pybullet; os._exit(pybullet.connect(pybullet.GUI) < 0)"
_TRIAL_SECONDS = 30.0
_DIVERTING = threading.RLock()


class Physics:
    """One world, independent of others in the same process.

    Attributes:
        config: Settings of the physics.
        client: PyBullet's functions, bound to this world.
        floor: Number of the body that is the floor.
        step_time: Duration of a physics step in seconds.
    """

    def __init__(self, config: PhysicsConfig, *, gui: bool = False) -> None:
        """Make a world with a floor, in a window if `gui`."""
        self.config, self.client, self._gui = config, connect(gui=gui), gui
        self.client.configureDebugVisualizer(self.client.COV_ENABLE_GUI, 0)
        self.client.setGravity(0.0, 0.0, -config.gravity)
        # Without the second parameter, the order of pairs depends on the history before a reset.
        self.client.setPhysicsEngineParameter(
            numSolverIterations=config.iterations, deterministicOverlappingPairs=1
        )
        plane = self.client.createCollisionShape(self.client.GEOM_PLANE)
        self.floor: int = self.client.createMultiBody(0.0, plane)
        self.step_time = 0.0
        self._bodies: list[int] = []
        self._saved: int | None = None

    def load(self, path: Path, urdf: str | None = None, *, fixed: bool) -> int:
        """Return the number of a new body at the origin.

        `urdf` replaces the content of the file `path`; its mesh paths are absolute. Raises if
        PyBullet cannot load it or one of its meshes.
        """
        client = self.client
        flags = client.URDF_USE_INERTIA_FROM_FILE
        robot = read_xml(path, "robot") if urdf is None else parse_xml(urdf, "robot", str(path))
        if _has_parents_first(robot):  # with the flag, dynamics of others would fail
            flags |= client.URDF_MAINTAIN_LINK_ORDER
        client.setAdditionalSearchPath(str(path.absolute().parent))
        with TemporaryFile() as output, NamedTemporaryFile(suffix=".urdf") as file:
            file.write((urdf or "").encode())
            file.flush()

            def messages() -> list[str]:
                output.seek(0)
                texts = _MESSAGE.split(output.read().decode(errors="replace"))
                return [" ".join(text.split()) for text in texts if text.strip()]

            source = str(path) if urdf is None else file.name
            try:
                with _diverted(output.fileno()):
                    body: int = client.loadURDF(source, useFixedBase=fixed, flags=flags)
            except client.error as error:
                reason = "; ".join(messages()) or error
                raise KinfeasError(f"{path}: PyBullet cannot load it: {reason}") from error
            unread = [text for text in messages() if _UNREAD_MESH.search(text)]
        if unread:  # PyBullet loads the link without the shape
            raise KinfeasError(
                f"{path}: PyBullet: {unread[0]}; meshes must be binary STL, OBJ or DAE files"
            )
        self._bodies.append(body)
        return body

    def links(self, body: int) -> dict[str, int]:
        """Return the indices of a body's links by name."""
        root, _ = self.client.getBodyInfo(body)
        return {root.decode(): ROOT, **{info[12].decode(): info[0] for info in self._infos(body)}}

    def joints(self, body: int) -> dict[str, int]:
        """Return the indices of a body's moving joints by name, in order."""
        fixed = self.client.JOINT_FIXED
        return {info[1].decode(): info[0] for info in self._infos(body) if info[2] != fixed}

    def _infos(self, body: int) -> list[Any]:
        return [self.client.getJointInfo(body, i) for i in range(self.client.getNumJoints(body))]

    def link_pose(self, body: int, link: int) -> Array:
        """Return the world pose of a link's frame, shape (7,)."""
        if link == ROOT:
            return compose(self.mass_pose(body, ROOT), relative(IDENTITY, self._mass_in_root(body)))
        state = self.client.getLinkState(body, link, computeForwardKinematics=True)
        return np.concatenate(state[4:6])

    def mass_pose(self, body: int, link: int) -> Array:
        """Return the world pose of a link's inertial frame, shape (7,)."""
        if link == ROOT:
            return np.concatenate(self.client.getBasePositionAndOrientation(body))
        state = self.client.getLinkState(body, link, computeForwardKinematics=True)
        return np.concatenate(state[0:2])

    def motion(self, body: int, link: int) -> tuple[Array, Array, Array]:
        """Return pose (7,), linear and angular velocity (3,) of a link's inertial frame."""
        if link == ROOT:
            linear, angular = self.client.getBaseVelocity(body)
            return self.mass_pose(body, ROOT), np.array(linear), np.array(angular)
        state = self.client.getLinkState(body, link, 1, 1)  # velocity, present pose
        return np.concatenate(state[0:2]), np.array(state[6]), np.array(state[7])

    def place(self, body: int, pose: Array) -> None:
        """Place the root link of a body at rest at a world pose, shape (7,)."""
        mass_pose = compose(pose, self._mass_in_root(body))
        self.client.resetBasePositionAndOrientation(body, mass_pose[:3], mass_pose[3:])
        self.client.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3)

    def divide(self, dt: float) -> int:
        """Return the number of physics steps of a control period, and set their duration."""
        steps = self.config.divide(dt)
        if dt / steps != self.step_time:
            self.step_time = dt / steps
            self.client.setTimeStep(self.step_time)
        return steps

    def look_at(self, base_pose: Array) -> None:
        """Turn the window, if there is one, to a base pose, shape (7,)."""
        if self._gui:
            target = [*base_pose[:2], _WINDOW_HEIGHT]
            self.client.resetDebugVisualizerCamera(*_WINDOW_CAMERA, target)

    def save(self) -> None:
        """Save the state for `restore`; bodies that are added later must be removed before."""
        self._saved = self.client.saveState()

    def restore(self) -> None:
        """Restore the saved state, with its contacts."""
        # Contacts that persist would keep their impulses and their order: separate all bodies.
        for number, body in enumerate(self._bodies):
            position = [0.0, 0.0, _AWAY * (number + 1.0)]
            self.client.resetBasePositionAndOrientation(body, position, IDENTITY[3:])
        self.client.performCollisionDetection()
        self.client.restoreState(self._saved)

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Return a context that turns errors, as of a closed window, into KinfeasError."""
        try:
            yield
        except self.client.error as error:
            raise KinfeasError(f"PyBullet fails, or its window was closed: {error}") from error

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self.client.leave()

    def _mass_in_root(self, body: int) -> Array:
        return np.concatenate(self.client.getDynamicsInfo(body, ROOT)[3:5])


def connect(*, gui: bool) -> Any:
    """Return the functions of PyBullet, bound to a new world, in a window if `gui`."""
    with silence():
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

    if gui and sys.platform == "linux":
        _check_display()

    class Client(BulletClient):  # type: ignore[misc]  # it has no types
        def __getattr__(self, name: str) -> Any:
            # Cached, because `BulletClient` binds a function at each use: thirty in a physics step.
            self.__dict__[name] = function = super().__getattr__(name)
            return function

        def leave(self) -> None:
            # Cached functions must not reach the next connection with the same number.
            if self.isConnected():
                self.disconnect()
            self.__dict__.clear()
            self._client = -1

    try:
        with silence():
            return Client(pybullet.GUI if gui else pybullet.DIRECT)
    except pybullet.error as error:
        raise KinfeasError(f"PyBullet cannot create a world: {error}") from error


def _check_display() -> None:
    """Check in another process that a window can be opened: PyBullet exits where it cannot."""
    command = [sys.executable, "-c", _TRIAL]
    try:
        subprocess.run(command, capture_output=True, timeout=_TRIAL_SECONDS, check=True)
    except subprocess.SubprocessError as error:
        display = os.environ.get("DISPLAY", "")
        raise KinfeasError(
            f"PyBullet cannot open a window: no usable screen, DISPLAY={display}"
        ) from error


@contextmanager
def silence() -> Iterator[None]:
    """Return a context that drops all standard output and error, also that of C libraries."""
    with Path(os.devnull).open("wb") as nowhere, _diverted(nowhere.fileno()):
        yield


def _has_parents_first(robot: Element) -> bool:
    """Return whether a URDF has each link after its parent."""
    order = [link.text("name") for link in robot.children("link")]
    return all(
        order.index(joint.need("parent").text("link"))
        < order.index(joint.need("child").text("link"))
        for joint in robot.children("joint")
    )


@contextmanager
def _diverted(to: int) -> Iterator[None]:
    """Return a context in which standard output and error go to another file descriptor.

    One thread at a time: descriptors are those of the process.
    """
    libc = ctypes.CDLL(None)

    def flush() -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        libc.fflush(None)

    with _DIVERTING:
        flush()
        saved = {stream: os.dup(stream) for stream in (1, 2)}
        for stream in saved:
            os.dup2(to, stream)
        try:
            yield
        finally:
            flush()
            for stream, before in saved.items():
                os.dup2(before, stream)
                os.close(before)
