"""References that share no code with the kernels, Pinocchio and Coal, and random draws."""

import math
from pathlib import Path

import coal
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, planar_pose
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot


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


def apart(*pair):
    """Return the distance of two placed shapes of Coal, and their nearest points."""
    result = coal.DistanceResult()
    distance = coal.distance(*pair, coal.DistanceRequest(), result)
    return distance, result.getNearestPoint1(), result.getNearestPoint2()


class Shapes:
    """Collision shapes of a robot for Coal, placed by Pinocchio.

    Attributes:
        links: Name of the link of each of them.
        model: All of them, for Pinocchio.
    """

    def __init__(self, robot: Robot) -> None:
        self.judge, kind = Pinocchio(robot), pinocchio.GeometryType.COLLISION
        self.model = pinocchio.buildGeomFromUrdf(self.judge.model, str(robot.urdf_path), kind)
        frames = [shape.parentFrame for shape in self.model.geometryObjects]
        self.links = [self.judge.model.frames[frame].name for frame in frames]

    def collide(self, joint_positions: Array) -> bool:
        """Return whether any pair of the model touches at the arm's joint positions, (v,)."""
        judge, data = self.judge, self.model.createData()
        judge.place(joint_positions)
        return pinocchio.computeCollisions(judge.model, judge.data, self.model, data, judge.q, True)


class Among(Shapes):
    """A robot among solids: distances of the shapes of its base and of its arm."""

    def __init__(self, robot):
        super().__init__(robot)
        names, body = list(robot.urdf.links), build_collision_model(robot).body
        order = np.argsort([names.index(link) for link in self.links], kind="stable")
        self.groups = order[body < 0].tolist(), order[body >= 0].tolist()

    def distances(self, joint_positions, solids, row):
        """Return the distance of each group to the nearest solid, metres; negative if inside."""
        self.judge.place(joint_positions)
        data, nearest = self.model.createData(), [np.inf, np.inf]
        pinocchio.updateGeometryPlacements(self.judge.model, self.judge.data, self.model, data)
        placed = [
            (shape.geometry, coal.Transform3s(pose.rotation, pose.translation))
            for shape, pose in zip(self.model.geometryObjects, data.oMg, strict=True)
        ]
        for (x, y, turn), (a, b, low, high), cylinder in zip(
            solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
        ):
            if a > 0.0:
                box = coal.Box(2.0 * a, 2.0 * b, high - low)
                solid = coal.Cylinder(a, high - low) if cylinder else box
                matrix = Rotation.from_euler("z", turn).as_matrix()
                there = coal.Transform3s(matrix, np.array([x, y, (low + high) / 2.0]))
                for group, shapes in enumerate(self.groups):
                    away = [apart(*placed[i], solid, there)[0] for i in shapes]
                    nearest[group] = min(nearest[group], *away)
        return nearest


@pytest.fixture(scope="session", params=["pr2", "tiago", "hsr", "odd_robot"])
def robot(request):
    """The last one has skewed axes and mimic joints, prismatic ones too."""
    odd = Path(__file__).parent / "odd_robot.yaml"
    return load_robot(odd if request.param == "odd_robot" else request.param)


@pytest.fixture(scope="session")
def judge(robot):
    return Pinocchio(robot)


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
