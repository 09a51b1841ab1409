"""References that share no code with the kernels, Pinocchio and FCL, and random draws."""

import math
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, planar_pose, rotation
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape


class Pinocchio:
    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = pinocchio.buildModelFromUrdf(str(robot.urdf_path))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(robot.ee_frame)

    def place(self, joint_positions: Array) -> None:
        """Move all links to the arm's joint positions, shape (v,)."""
        self.q = pinocchio.neutral(self.model)
        for name, joint in self.robot.urdf.joints.items():
            if joint.moves:
                constant, slopes = self.drive(name)
                position = constant + float(slopes @ joint_positions)
                place = self.model.joints[self.model.getJointId(name)]
                endless = place.nq == 2
                values = [math.cos(position), math.sin(position)] if endless else [position]
                self.q[place.idx_q : place.idx_q + place.nq] = values
        pinocchio.framesForwardKinematics(self.model, self.data, self.q)

    def pose(self, joint_positions: Array) -> tuple[Array, Array]:
        """Return position, shape (3,), and orientation, shape (3, 3), of the EE."""
        self.place(joint_positions)
        placement = self.data.oMf[self.frame]
        return placement.translation.copy(), placement.rotation.copy()

    def link(self, name: str) -> tuple[Array, Array]:
        """Return orientation, shape (3, 3), and position, shape (3,), of a link after `place`."""
        placement = self.data.oMf[self.model.getFrameId(name)]
        return placement.rotation.copy(), placement.translation.copy()

    def jacobian(self, joint_positions: Array) -> Array:
        """Return the EE's Jacobian by the arm's variables, shape (6, v)."""
        self.place(joint_positions)
        axes = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return self.by_variables(
            pinocchio.computeFrameJacobian(self.model, self.data, self.q, self.frame, axes)
        )

    def gravity_torques(self, joint_positions: Array) -> Array:
        """Return the generalized gravity forces of the arm's variables, shape (v,)."""
        self.place(joint_positions)
        return self.by_variables(pinocchio.computeGeneralizedGravity(self.model, self.data, self.q))

    def by_variables(self, derivatives: Array) -> Array:
        """Return derivatives by the arm's variables, (..., v), from those by all joints."""
        moving = [joint.name for joint in self.robot.urdf.joints.values() if joint.moves]
        columns = [self.model.joints[self.model.getJointId(name)].idx_v for name in moving]
        return derivatives[..., columns] @ np.array([self.drive(name)[1] for name in moving])

    def drive(self, name: str) -> tuple[float, Array]:
        """Return a joint's position at zero variables and its derivatives by them, shape (v,)."""
        names = [joint.name for joint in self.robot.arm]
        mimic = self.robot.urdf.joints[name].mimic
        if name in names:
            return 0.0, np.eye(len(names))[names.index(name)]
        if mimic is None:
            return self.robot.fixed_joints[name], np.zeros(len(names))
        constant, slopes = self.drive(mimic.joint)
        return mimic.multiplier * constant + mimic.offset, mimic.multiplier * slopes

    def miss(self, ee_pose: Array, joint_positions: Array) -> Array:
        """Return the errors of joint positions (n, v) for EE poses (n, 7): (n, 2), metres, rad."""
        turns = Rotation.from_quat(ee_pose[:, 3:]).as_matrix()
        errors = np.empty((len(ee_pose), 2))
        for i, joints in enumerate(joint_positions):
            position, turn = self.pose(joints)
            errors[i, 0] = np.linalg.norm(position - ee_pose[i, :3])
            errors[i, 1] = np.linalg.norm(Rotation.from_matrix(turn.T @ turns[i]).as_rotvec())
        return errors


class Primitives:
    """FCL's primitives of a robot, placed by Pinocchio.

    Attributes:
        shapes: Link and shape of each of them.
        objects: For FCL.
        radius: Radii of bounding spheres, metres.
    """

    def __init__(self, robot: Robot, judge: Pinocchio) -> None:
        self.judge = judge
        self.shapes = [
            (link.name, shape) for link in robot.urdf.links.values() for shape in link.shapes
        ]
        kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
        geometries = [kinds[shape.kind](*shape.size) for _, shape in self.shapes]
        self.objects = list(map(fcl.CollisionObject, geometries))
        self.radius = np.array([_radius(shape) for _, shape in self.shapes])

    def place(self, joint_positions: Array) -> Array:
        """Move all primitives to the arm's joint positions, (v,); return their centres, (s, 3)."""
        self.judge.place(joint_positions)
        centres = np.empty((len(self.shapes), 3))
        for i, (link, shape) in enumerate(self.shapes):
            turn, position = self.judge.link(link)
            centres[i] = position + turn @ shape.pose[:3]
            placement = fcl.Transform(turn @ rotation(shape.pose).as_matrix(), centres[i])
            self.objects[i].setTransform(placement)
        return centres


def _radius(shape: Shape) -> float:
    x = np.array(shape.size)
    sizes = {"box": x / 2.0, "cylinder": x / [1.0, 2.0] if len(x) == 2 else x, "sphere": x}
    return float(np.linalg.norm(sizes[shape.kind]))


def touch(one: Any, other: Any) -> bool:
    return fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()) > 0


def fcl_solids(solids, row):
    """Return the solids of a row for FCL."""
    objects = []
    for (x, y, turn), size, cylinder in zip(
        solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
    ):
        if size[0] > 0.0:
            high = size[3] - size[2]
            shape = fcl.Cylinder(size[0], high) if cylinder else fcl.Box(*2.0 * size[:2], high)
            matrix = Rotation.from_euler("z", turn).as_matrix()
            placement = fcl.Transform(matrix, [x, y, (size[2] + size[3]) / 2.0])
            objects.append(fcl.CollisionObject(shape, placement))
    return objects


class Among(Primitives):
    def __init__(self, robot, judge):
        super().__init__(robot, judge)
        body = build_collision_model(robot).body
        self.groups = np.flatnonzero(body < 0), np.flatnonzero(body >= 0)

    def touch(self, joint_positions, solids, row):
        """Return whether each group of shapes touches; bounding spheres rule most pairs out."""
        centres, objects = self.place(joint_positions), fcl_solids(solids, row)
        middle = np.array([solid.getTranslation() for solid in objects]).reshape(-1, 3)
        used = solids.size[row, solids.size[row, :, 0] > 0.0]
        reach = np.linalg.norm([used[:, 0], used[:, 1], (used[:, 3] - used[:, 2]) / 2.0], axis=0)
        near = np.linalg.norm(centres[:, np.newaxis] - middle, axis=2) <= (
            self.radius[:, np.newaxis] + reach
        )
        return [
            any(touch(self.objects[i], objects[k]) for i in group for k in np.flatnonzero(near[i]))
            for group in self.groups
        ]

    def distances(self, joint_positions, solids, row):
        """Return the distance of each group of shapes to the nearest solid, metres."""
        self.place(joint_positions)
        objects = fcl_solids(solids, row)
        return [
            min(
                (fcl.distance(self.objects[i], solid) for i in group for solid in objects),
                default=np.inf,
            )
            for group in self.groups
        ]


@pytest.fixture(scope="session")
def odd_robot() -> Robot:
    """A robot with skewed axes and mimic joints, prismatic ones too."""
    return load_robot(Path(__file__).parent / "odd_robot.yaml")


@pytest.fixture(scope="session")
def judge(robot):
    return Pinocchio(robot)


@pytest.fixture(scope="session")
def odd_judge(odd_robot):
    return Pinocchio(odd_robot)


def draw(robot: Robot, n: int, seed: int = 0) -> Array:
    """Return n random configurations within the limits of a robot, shape (n, v)."""
    lower, upper = robot.finite_joint_limits
    return np.random.default_rng(seed).uniform(lower, upper, (n, len(lower)))


def draw_solids(n: int, places: int, reach: float = 2.5, seed: int = 0) -> Solids:
    """Return solids around the world's origin; a tenth of the places is empty."""
    rng = np.random.default_rng(seed)
    solids = Solids.empty(n, places)
    solids.pose[:] = rng.uniform([-reach, -reach, -np.pi], [reach, reach, np.pi], (n, places, 3))
    solids.cylinder[:] = rng.random((n, places)) < 0.4
    half = rng.uniform(0.03, 0.5, (n, places, 2)) * (rng.random((n, places, 1)) < 0.9)
    solids.size[..., 0] = half[..., 0]
    solids.size[..., 1] = np.where(solids.cylinder, half[..., 0], half[..., 1])
    solids.size[..., 2] = rng.uniform(-0.5, 1.0, (n, places)).clip(0.0)
    solids.size[..., 3] = solids.size[..., 2] + rng.uniform(0.02, 1.0, (n, places))
    return solids


def draw_bases(n: int, seed: int = 0) -> Array:
    """Return n poses of bases near the world's origin."""
    x, y, heading = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, n)) * [[1.0], [1.0], [3.0]]
    return planar_pose(x, y, heading)
