"""The objects of a scene, and solids, as PyBullet bodies."""

import numpy as np

from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.solids import Solids
from kinfeas.scenes.objects import free_joints
from kinfeas.scenes.scene import Scene


class Furniture:
    """The objects of a scene; doors and drawers move with friction and damping.

    Attributes:
        scene: Poses and joint positions at the next reset.
        bodies: PyBullet's numbers of the objects, by name.
        joints: Those of their joints, by the names of object and joint.
    """

    def __init__(self, physics: Physics, scene: Scene) -> None:
        self._physics, self.scene = physics, scene
        self.bodies = {
            name: physics.load(item.urdf_path, fixed=item.fixed)
            for name, item in scene.objects.items()
        }
        self.joints = {name: physics.joints(body) for name, body in self.bodies.items()}
        self._links = {name: physics.links(body) for name, body in self.bodies.items()}
        self.apply_step_time()
        self.place()

    def apply_step_time(self) -> None:
        """Set joint friction again: PyBullet keeps impulses, which depend on the step time."""
        for name, item in self.scene.objects.items():
            for joint in free_joints(item.urdf).values():
                number = self.joints[name][joint.name]
                self._physics.client.setJointMotorControl2(
                    self.bodies[name], number, self._physics.client.VELOCITY_CONTROL,
                    targetVelocity=0.0, force=joint.friction,
                )  # fmt: skip

    def place(self) -> None:
        """Place all objects as in the scene, at rest."""
        for name, item in self.scene.objects.items():
            body, joints = self.bodies[name], self.joints[name]
            self._physics.place(body, item.pose)
            for joint, position in item.joint_positions.items():
                self._physics.client.resetJointState(body, joints[joint], position, 0.0)

    def link(self, name: str, link: str) -> tuple[int, int]:
        """Return PyBullet's numbers of an object and of one of its links."""
        return self.bodies[name], self._links[name][link]


class SolidBodies:
    """The solids of a robot, a row of `Solids`, as bodies that no force moves.

    Attributes:
        bodies: PyBullet's numbers, by the place in the row.
    """

    def __init__(self, physics: Physics) -> None:
        self._client = physics.client
        self.bodies: dict[int, int] = {}

    def place(self, solids: Solids) -> None:
        """Replace the solids in the world."""
        self.clear()
        client = self._client
        (places,) = np.nonzero(solids.filled[0])
        for place, pose in zip(places.tolist(), solids.centre[0, places].tolist(), strict=True):
            x, y, low, high = solids.size[0, place].tolist()
            create, height = client.createCollisionShape, high - low
            if solids.cylinder[0, place]:
                shape = create(client.GEOM_CYLINDER, radius=x, height=height)
            else:
                shape = create(client.GEOM_BOX, halfExtents=[x, y, height / 2.0])
            self.bodies[place] = client.createMultiBody(0.0, shape, -1, pose[:3], pose[3:])

    def move(self, solids: Solids) -> None:
        """Move moving solids to their present poses."""
        centre = solids.centre[0].tolist()
        for place in np.flatnonzero(solids.velocity[0].any(axis=1)).tolist():
            if place in self.bodies:
                self._client.resetBasePositionAndOrientation(
                    self.bodies[place], centre[place][:3], centre[place][3:]
                )

    def clear(self) -> None:
        """Take all solids out of the world."""
        for body in self.bodies.values():
            self._client.removeBody(body)
        self.bodies = {}
