"""The PyBullet world as a backend of the loop: robots with inertia, motors and contacts."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from kinfeas.backends.physics.backend import ROBOT, LinkName, Motion, PhysicsBackend
from kinfeas.backends.physics.robot import PLANAR_JOINTS
from kinfeas.backends.pybullet.furniture import Furniture
from kinfeas.backends.pybullet.simulation import Simulation
from kinfeas.core.backend import Contacts, Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.scenes.scene import Scene

_TOUCH = 1e-3  # m, largest distance of a contact


class PyBulletBackend(PhysicsBackend):
    """n robots, each in a PyBullet world of its own; arguments as in `PhysicsBackend`."""

    engine = "PyBullet"

    @cached_property
    def _sims(self) -> list[Simulation]:
        return []

    @property
    def sims(self) -> list[Simulation]:
        """The simulations, at least one; `reset` adds the missing ones."""
        self.simulation(0)
        return self._sims

    def simulation(self, row: int) -> Simulation:
        """Return the simulation of a robot; missing ones are built."""
        while len(self._sims) <= row:
            gui = self._gui and not self._sims
            simulation = Simulation(self.robot, self.scene, self.config, self._handled, gui=gui)
            self._sims.append(simulation)
        return self._sims[row]

    def open(self) -> None:
        """Build the first simulation, and its window; a second call does nothing."""
        self.simulation(0)

    def touching(self, env_id: int) -> Contacts:
        """Return the current contacts of a robot, as in `PhysicsBackend`."""
        return self.sims[env_id].contacts()

    def grip(self, grip: Grip, env_ids: Rows) -> None:
        """Start to close or open grippers, as in `PhysicsBackend`."""
        for row in env_ids.tolist():
            self._sims[row].grip(grip)

    def scale_dynamics(
        self, mass: Array, friction: Array, motor_gain: Array, env_ids: Rows
    ) -> None:
        """Change the dynamics of robots, as in `Dynamics`."""
        for row, *factors in zip(env_ids.tolist(), mass, friction, motor_gain, strict=True):
            self._sims[row].scale_dynamics(*factors)

    def close(self) -> None:
        """End the simulations; a second call does nothing."""
        for simulation in self._sims:
            simulation.physics.close()
        self._sims.clear()

    def place(
        self, row: int, scene: Scene | None, base_pose: Array, joint_positions: Array
    ) -> bool:
        """Place objects and robot of a row, as in `PhysicsBackend`."""
        simulation = self.simulation(row)
        if scene is not None and simulation.furniture is not None:
            simulation.furniture.scene = scene
        simulation.reset(base_pose, joint_positions)
        simulation.physics.client.performCollisionDetection()
        contacts = simulation.contacts()
        return not (contacts.base or contacts.arm)

    def link_poses(self, row: int, links: Sequence[LinkName]) -> Array:
        """Return the world poses of links of a row, shape (k, 7)."""
        sim = self.sims[row]
        body, furniture = sim.body, sim.furniture
        numbers = [
            (body.body, body.links[link])
            if owner == ROBOT or furniture is None
            else furniture.link(owner, link)
            for owner, link in links
        ]
        return np.stack([sim.physics.link_pose(*each) for each in numbers])

    def object_motion(self, row: int, name: str) -> tuple[Array, float]:
        """Return pose (7,) and linear speed (m/s) of the root link of an object."""
        furniture, physics = self._furniture(row), self.sims[row].physics
        velocity, _ = physics.client.getBaseVelocity(furniture.bodies[name])
        pose = physics.link_pose(*furniture.link(name, furniture.scene.objects[name].urdf.root))
        return pose, float(np.linalg.norm(velocity))

    def object_joint(self, row: int, name: str, joint: str) -> float:
        """Return the position of an object's joint, rad or m."""
        furniture, client = self._furniture(row), self.sims[row].physics.client
        return client.getJointState(furniture.bodies[name], furniture.joints[name][joint])[0]

    def is_on(self, row: int, name: str, below: str, steepest: float) -> bool:
        """Return whether an object is on another one, as in `PhysicsBackend`."""
        bodies, client = self._furniture(row).bodies, self.sims[row].physics.client
        points = client.getContactPoints(bodyA=bodies[name], bodyB=bodies[below])
        # The contact normal points from the other object to this one.
        return any(point[8] <= _TOUCH and point[7][2] >= steepest for point in points)

    def holds(self, row: int, name: str) -> bool:
        """Return whether the gripper holds an object."""
        grasp = self.sims[row].grasp
        held = grasp.held if grasp else None
        return held is not None and held[0] == self._furniture(row).bodies[name]

    def joint_motion(self) -> Motion:
        """Return the motion of all joints of the first robot except those of its base."""
        sim = self.sims[0]
        with sim.physics.connected():
            joints = {name: at for name, at in sim.body.joints.items() if name not in PLANAR_JOINTS}
            states = sim.physics.client.getJointStates(sim.body.body, list(joints.values()))
        positions, velocities = zip(*(state[:2] for state in states), strict=True)
        return dict(zip(joints, positions, strict=True)), dict(zip(joints, velocities, strict=True))

    def touched(self, row: int = 0) -> list[str]:
        """Return the names of the objects that the robot touches; the floor is `the floor`."""
        sim = self.sims[row]
        sim.physics.client.performCollisionDetection()
        contacts = sim.contacts()
        bodies = {body for _, body, _ in contacts.base | contacts.arm}
        things = {**(sim.furniture.bodies if sim.furniture else {}), "the floor": sim.physics.floor}
        things |= {f"solid {place}": body for place, body in sim.solids.bodies.items()}
        return [name for name, body in things.items() if body in bodies]

    def _furniture(self, row: int) -> Furniture:
        furniture = self.sims[row].furniture
        if furniture is None:
            raise KinfeasError("the world has no scene")
        return furniture

    def _reset(self, rows: Rows, base_pose: Array, joint_positions: Array) -> None:
        for row, pose, joints in zip(rows.tolist(), base_pose, joint_positions, strict=True):
            self.simulation(row).reset(pose, joints)

    def _base_meshes(self) -> list[Array]:
        return self.sims[0].body.base_meshes()

    def _place_solids(self, rows: Rows, solids: Solids) -> None:
        for row in rows.tolist():
            self._sims[row].solids.place(solids.of(np.array([row])))

    def _move_solids(self, solids: Solids) -> None:
        for row in range(len(self._positions)):
            self._sims[row].solids.move(solids.of(np.array([row])))

    def _step(self, rows: Rows, base_twist: Array, joint_targets: Array, dt: float) -> None:
        for row, twist, joints in zip(rows.tolist(), base_twist, joint_targets, strict=True):
            self._sims[row].step(twist, joints, dt)

    def _read(self, rows: Rows) -> tuple[list[list[float]], list[list[float]]]:
        measured = [self._sims[row].measure() for row in rows.tolist()]
        return [position for position, _ in measured], [velocity for _, velocity in measured]
