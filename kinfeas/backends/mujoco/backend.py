"""The MuJoCo world as a backend of the loop: n robots, stepped side by side on several cores."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.mujoco.model import ROBOT, Model
from kinfeas.backends.mujoco.simulations import Simulations
from kinfeas.backends.physics.backend import LinkName, Motion, PhysicsBackend
from kinfeas.backends.physics.robot import PLANAR_JOINTS
from kinfeas.core.backend import Contacts, Grip, RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.scenes.scene import Scene


class MuJoCoBackend(PhysicsBackend):
    """n robots, each in a room of its own; arguments as in `PhysicsBackend`."""

    engine = "MuJoCo"
    _places = 0

    @cached_property
    def model(self) -> Model:
        """Model of robot and room, with places for solids; the first use builds it."""
        return Model(self.robot, self.scene, self.config, self._handled, self._places)

    @cached_property
    def sims(self) -> Simulations:
        """The simulations; `reset` and `place` add the missing ones."""
        return Simulations(self.model, self.config, 1)

    def open(self) -> None:
        """Build the first simulation; a second call does nothing."""
        if self._gui:
            raise KinfeasError("the MuJoCo world has no window; use PyBullet, or a 'replay'")
        self._provide(0)

    def close(self) -> None:
        """End the simulations; a second call does nothing."""
        for name in ("model", "sims"):
            self.__dict__.pop(name, None)

    @property
    def resumable(self) -> "MuJoCoBackend":  # type: ignore[override]  # never replaced
        """Saves and restores the state: the backend itself."""
        return self

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state of all robots, their rooms and their motors."""
        n = len(self._positions)
        own = {key: values[:n].copy() for key, values in self.sims.state().items()}
        return {**own, **self.solids.snapshot()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Continue from a `snapshot` and return the measured state."""
        n = len(snapshot["physics_state"])
        self.solids.restore(snapshot, n)
        self._standing = None
        if more := snapshot["physics_objects"].shape[1] - self.model.engine.nmocap:
            self._set_places(self._places + more)
        self._provide(n - 1)
        if (bodies := self.solid_bodies()) is not None:
            self.sims.place_solids(np.arange(n), bodies)
        for key, values in self.sims.state().items():
            values[:n] = snapshot[key]
        self.sims.scale_dynamics(np.arange(n))
        width = 3 + len(self.robot.arm)
        self._positions, self._velocities = np.zeros((2, n, width))
        return self._measure(np.arange(n))

    def grip(self, grip: Grip, env_ids: Rows) -> None:
        """Start to close or open grippers, as in `PhysicsBackend`."""
        if self.robot.gripper is not None:
            self.sims.grip(grip, env_ids)

    def scale_dynamics(
        self, mass: Array, friction: Array, motor_gain: Array, env_ids: Rows
    ) -> None:
        """Change the dynamics of robots, as in `Dynamics`."""
        self.sims.dynamics[env_ids] = np.stack([mass, friction, motor_gain], axis=1)
        self.sims.scale_dynamics(env_ids)

    def touching(self, env_id: int) -> Contacts:
        """Return the current contacts of a robot, as in `PhysicsBackend`."""
        if self.sims.touches[env_id] == 0.0:
            return Contacts(frozenset(), frozenset())
        return self._contacts(env_id)

    def place(
        self, row: int, scene: Scene | None, base_pose: Array, joint_positions: Array
    ) -> bool:
        """Place objects and robot of a row, as in `PhysicsBackend`."""
        self._provide(row)
        if scene is not None:
            self.sims.arrange(row, scene)
        self._reset(np.array([row]), base_pose[np.newaxis], joint_positions[np.newaxis])
        contacts = self._contacts(row)
        return not (contacts.base or contacts.arm)

    def link_poses(self, row: int, links: Sequence[LinkName]) -> Array:
        """Return the world poses of links of a row, shape (k, 7)."""
        return self.sims.poses(row, [self.model.body(*link) for link in links])

    def object_motion(self, row: int, name: str) -> tuple[Array, float]:
        """Return pose (7,) and linear speed (m/s) of the root link of an object."""
        pose = self.sims.poses(row, [self.model.root(name)])[0]
        if self.model.objects[name].fixed:
            return pose, 0.0
        at = int(self.model.engine.joint(f"{name}:free").dofadr[0])
        return pose, float(np.linalg.norm(self.sims.qvel[row, at : at + 3]))

    def object_joint(self, row: int, name: str, joint: str) -> float:
        """Return the position of an object's joint, rad or m."""
        return float(self.sims.qpos[row, self.model.address(name, joint)])

    def is_on(self, row: int, name: str, below: str, steepest: float) -> bool:
        """Return whether an object is on another one, as in `PhysicsBackend`."""
        numbers = list(self.model.objects)
        pair = np.array([numbers.index(below), numbers.index(name)])
        bodies, normals = self.sims.contacts(row)
        owners = self.model.owner[bodies]
        # Normals point from the first body of a contact to the second.
        upward = np.where(owners[:, 0] == pair[0], normals[:, 2], -normals[:, 2])
        return bool(np.any((np.sort(owners) == np.sort(pair)).all(axis=1) & (upward >= steepest)))

    def holds(self, row: int, name: str) -> bool:
        """Return whether the gripper holds an object."""
        return self._handled is not None and self._handled[0] == name and bool(self.sims.held[row])

    def joint_motion(self) -> Motion:
        """Return the motion of all joints of the first robot except those of its base."""
        qpos, qvel = self.sims.qpos[0], self.sims.qvel[0]
        joints = {n: at for n, at in self.model.joints.items() if n not in PLANAR_JOINTS}
        velocities = {name: float(qvel[at]) for name, (_, at) in joints.items()}
        return {name: float(qpos[at]) for name, (at, _) in joints.items()}, velocities

    def touched(self, row: int = 0) -> list[str]:
        """Return the names of the objects that the robot touches; the floor is `the floor`."""
        contacts = self._contacts(row)
        solids = [f"solid {place}" for place in range(self._places)]
        names = [*self.model.objects, *solids, "the floor"]
        return sorted({names[other] for _, other, _ in contacts.base | contacts.arm})

    def _base_meshes(self) -> list[Array]:
        return self.model.base_meshes()

    def _contacts(self, row: int) -> Contacts:
        owner, on_arm = self.model.owner, self.model.on_arm
        touching: tuple[list[tuple[int, int, int]], ...] = ([], [])
        spared = self.model.grasped[1] if self.model.grasp is not None else None
        bodies, _ = self.sims.contacts(row)
        for first, second in bodies[(owner[bodies] == ROBOT).any(axis=1)].tolist():
            own, other = (first, second) if owner[first] == ROBOT else (second, first)
            if other != spared or not on_arm[own]:
                touching[int(on_arm[own])].append((own, int(owner[other]), other))
        return Contacts(*map(frozenset, touching))

    def _provide(self, row: int) -> None:
        """Add simulations until there is one for a row."""
        if row >= (old := self.sims).n:
            self.sims = Simulations(self.model, self.config, max(row + 1, 2 * old.n))
            self.sims.adopt(old)

    def _set_places(self, places: int) -> None:
        """Set the number of places for solids; the next use rebuilds the model."""
        self._places = places
        self.close()

    def _place_solids(self, rows: Rows, solids: Solids) -> None:
        if solids.places > self._places:
            old = self.sims
            self._set_places(solids.places)
            self.sims = Simulations(self.model, self.config, old.n)
            self.sims.adopt(old)
        self.sims.place_solids(rows, solids.of(rows))

    def _move_solids(self, solids: Solids) -> None:
        self.sims.move_solids(np.arange(len(self._positions)), solids)

    def _reset(self, rows: Rows, base_pose: Array, joint_positions: Array) -> None:
        self._provide(int(rows.max(initial=0)))
        self.sims.reset(rows, base_pose, joint_positions)
        if self._handled is not None:
            self.grip("open", rows)

    def _step(self, rows: Rows, base_twist: Array, joint_targets: Array, dt: float) -> None:
        self.sims.step(rows, base_twist, joint_targets, dt, self.config.divide(dt))

    def _read(self, rows: Rows) -> tuple[Array, Array]:
        count, sims = 3 + len(self.robot.arm), self.sims
        positions, velocities = self.model.at[:, :count]
        return sims.qpos[rows][:, positions], sims.qvel[rows][:, velocities]
