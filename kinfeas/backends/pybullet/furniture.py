"""The objects of a scene as bodies of the PyBullet world."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from kinfeas.backends.pybullet.physics import Physics
from kinfeas.config.schema import no_such
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.tree import Joint
from kinfeas.scenes.objects import free_joints
from kinfeas.scenes.scene import Scene

T = TypeVar("T")

_REST = 0.05  # m/s, below which something stands
_TOUCH = 1e-3  # m, between things that touch
_UPRIGHT = float(np.cos(np.pi / 4.0))  # least share of a unit vector that points upwards


class Furniture:
    """What stands in a room; doors and drawers move with friction and damping.

    Attributes:
        scene: Where everything stands at the next reset.
        bodies: PyBullet's numbers of the objects, by name.
    """

    def __init__(self, physics: Physics, scene: Scene) -> None:
        """Put all objects of a scene into the world."""
        self._physics, self.scene = physics, scene
        self.bodies = {
            name: physics.load(one.urdf_path, fixed=one.fixed)
            for name, one in scene.objects.items()
        }
        self._joints = {name: physics.joints(body) for name, body in self.bodies.items()}
        self._links = {name: physics.links(body) for name, body in self.bodies.items()}
        self.retime()
        self.place()

    def furnish(self, scene: Scene) -> None:
        """Set where everything stands from the next reset on.

        Raises:
            KinfeasError: If the scene holds other objects than the world.
        """
        if scene.objects.keys() != self.bodies.keys():
            known, given = ", ".join(sorted(self.bodies)), ", ".join(sorted(scene.objects))
            raise KinfeasError(f"the scene must hold the world's objects {known}, not {given}")
        self.scene = scene

    def retime(self) -> None:
        """Follow a change of the physics step, for which PyBullet keeps impulses, not forces."""
        for name, one in self.scene.objects.items():
            for joint in free_joints(one.urdf).values():
                self._rub(name, joint)

    def place(self) -> None:
        """Put everything where the scene says, at rest."""
        for name, one in self.scene.objects.items():
            self._physics.place(self.bodies[name], one.pose)
            for joint, position in one.joint_positions.items():
                self._physics.client.resetJointState(
                    self.bodies[name], self._joints[name][joint], position, 0.0
                )

    def link(self, name: str, link: str) -> tuple[int, int]:
        """Return PyBullet's numbers of an object and of one of its links.

        Raises:
            KinfeasError: If there is no such object or link.
        """
        links = self._of(name, self._links)
        if link not in links:
            raise KinfeasError(f"object {name!r} has no link {link!r}{no_such(link, links)}")
        return self.bodies[name], links[link]

    def link_pose(self, name: str, link: str) -> Array:
        """Return the world pose of a link of an object, shape (7,)."""
        return self._physics.link_pose(*self.link(name, link))

    def joint_position(self, name: str, joint: str) -> float:
        """Return how far a joint of an object is open, rad or m.

        Raises:
            KinfeasError: If there is no such object or joint.
        """
        joints = self._of(name, self._joints)
        if joint not in joints:
            raise KinfeasError(f"object {name!r} has no joint {joint!r}{no_such(joint, joints)}")
        position: float = self._physics.client.getJointState(self.bodies[name], joints[joint])[0]
        return position

    def stands(self, name: str, on: str) -> bool:
        """Return whether an object is at rest on another one, as upright as the scene has it.

        What leans against the side of the other one or has fallen over does not stand on it.

        Raises:
            KinfeasError: If there is no such object.
        """
        client = self._physics.client
        body, below = (self._of(one, self.bodies) for one in (name, on))
        speed = float(np.linalg.norm(client.getBaseVelocity(body)[0]))
        points = client.getContactPoints(bodyA=body, bodyB=below)
        # The normal of a contact points from the other one to the object.
        borne = any(point[8] <= _TOUCH and point[7][2] >= _UPRIGHT for point in points)
        return speed <= _REST and borne and self._tilt(name) >= _UPRIGHT

    def _tilt(self, name: str) -> float:
        """Return how far upwards points what does so in the scene, from -1 to 1."""
        urdf = self.scene.objects[name].urdf
        now = rotation(self.link_pose(name, urdf.root)).as_matrix()
        return float((now @ rotation(self.scene.objects[name].pose).as_matrix().T)[2, 2])

    def _of(self, name: str, known: Mapping[str, T]) -> T:
        if name not in known:
            raise KinfeasError(f"there is no object {name!r}{no_such(name, known)}")
        return known[name]

    def _rub(self, name: str, joint: Joint) -> None:
        """Let a joint brake: a motor that wants to stand still and is as strong as its friction."""
        client = self._physics.client
        client.setJointMotorControl2(
            self.bodies[name],
            self._joints[name][joint.name],
            client.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=joint.friction,
        )
