"""Inverse kinematics of Pinocchio and PyBullet, for comparison.

Both load a URDF of the joints between base and EE. Both get limits and a seed, and Pinocchio as
many restarts as our own solver.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.backends.pybullet.physics import silence
from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkOptions
from kinfeas.robots.elements import numbers_text
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint

_METRES, _RADIANS = 1e-4, 1e-3
_ITERATIONS = 40
_DAMPING_FLOOR, _DAMPING_GAIN = 1e-6, 0.02


@dataclass(frozen=True)
class Peer:
    """A solver of another library.

    `prepare`, which is not timed, converts a target pose, shape (7,), for `solve`, which returns
    joint positions, shape (j,), for a target and a seed.
    """

    name: str
    prepare: Callable[[Array], Any]
    solve: Callable[[Any, Array], Array]


def pinocchio_peer(robot: Robot) -> Peer | None:
    """Return Pinocchio's damped least squares with clamping; None if it is not installed.

    The closed-loop inverse kinematics of Pinocchio's documentation, with damping by the squared
    error and random restarts.
    """
    if find_spec("pinocchio") is None or _mimics(robot):
        return None
    import pinocchio as pin

    model = pin.buildModelFromXML(arm_urdf(robot))
    data, frame = model.createData(), model.getFrameId(robot.ee_frame)
    lower, upper = robot.joint_limits
    lowest, highest = robot.finite_joint_limits

    def descend(target: Any, q: Array) -> tuple[Array, bool]:
        for _ in range(_ITERATIONS):
            pin.computeJointJacobians(model, data, q)
            placement = pin.updateFramePlacement(model, data, frame)
            error = pin.log6(placement.actInv(target)).vector
            metres, radians = error[:3] @ error[:3], error[3:] @ error[3:]
            if metres <= _METRES**2 and radians <= _RADIANS**2:
                return q, True
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
            damping = _DAMPING_FLOOR + _DAMPING_GAIN * (metres + radians)
            step = _damped_step(jacobian, error, damping)
            if (blocked := (q + step > upper) | (q + step < lower)).any():
                # Such a joint moves onto its limit, and the others reduce the remaining error.
                held = np.where(blocked, np.clip(q + step, lower, upper) - q, 0.0)
                rest = error - jacobian @ held
                step = held + _damped_step(np.where(blocked, 0.0, jacobian), rest, damping)
            q = np.clip(q + step, lower, upper)
        return q, False

    def solve(target: Any, seed: Array) -> Array:
        rng = np.random.default_rng(0)
        q, found = descend(target, seed)
        for _ in range(IkOptions().restarts):
            if found:
                break
            q, found = descend(target, rng.uniform(lowest, highest))
        return q

    return Peer("Pinocchio", pin.XYZQUATToSE3, solve)


def pybullet_peer(robot: Robot) -> Peer | None:
    """Return PyBullet's solver with limits and rest poses; None if it is not installed.

    One call with its default of 20 iterations; more solve more targets in more time.
    """
    if find_spec("pybullet") is None or _mimics(robot):
        return None
    with silence():
        import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(arm_urdf(robot), encoding="utf-8")
        body = pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    lower, upper = robot.finite_joint_limits
    limits = {
        "lowerLimits": lower.tolist(),
        "upperLimits": upper.tolist(),
        "jointRanges": (upper - lower).tolist(),
    }

    def solve(target: tuple[list[float], list[float]], seed: Array) -> Array:
        rest = seed.tolist()
        return np.array(
            pybullet.calculateInverseKinematics(
                body,
                count - 1,
                *target,
                **limits,
                restPoses=rest,
                currentPositions=rest,
                physicsClientId=client,
            )
        )

    return Peer("PyBullet", lambda pose: (pose[:3].tolist(), pose[3:].tolist()), solve)


def arm_urdf(robot: Robot) -> str:
    """Return a URDF of the joints from base to EE, with soft limits and those at rest fixed."""
    path = robot.urdf.path_to(robot.ee_frame)
    links = [robot.urdf.root, *(joint.child for joint in path)]
    body = "".join(
        f'<link name="{link}"><inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" '
        'iyy="0.01" iyz="0" izz="0.01"/></inertial></link>\n'
        for link in links
    )
    return (
        f'<robot name="arm">\n{body}{"".join(_joint_xml(robot, joint) for joint in path)}</robot>'
    )


def _joint_xml(robot: Robot, joint: Joint) -> str:
    arm = {arm_joint.name: arm_joint for arm_joint in robot.arm}.get(joint.name)
    origin, kind, inner = joint.origin, "fixed", ""
    if arm is not None:
        lower, upper = (-np.pi, np.pi) if arm.continuous else (arm.lower, arm.upper)
        # A continuous joint is limited to one turn, which all libraries understand.
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        inner = f'<axis xyz="{numbers_text(joint.axis)}"/>'
        inner += f'<limit lower="{lower}" upper="{upper}" velocity="{arm.velocity}" effort="1000"/>'
    elif joint.moves:
        origin = joint.pose_at(robot.fixed_joints[joint.name])
    rpy = numbers_text(spatial.rpy(origin))
    return (
        f'<joint name="{joint.name}" type="{kind}"><parent link="{joint.parent}"/>'
        f'<child link="{joint.child}"/><origin xyz="{numbers_text(origin[:3])}" rpy="{rpy}"/>'
        f"{inner}</joint>\n"
    )


def _damped_step(jacobian: Array, error: Array, damping: float) -> Array:
    normal = jacobian @ jacobian.T
    normal.flat[::7] += damping
    return jacobian.T @ np.linalg.solve(normal, error)


def _mimics(robot: Robot) -> bool:
    """Return whether a joint of the arm mimics another one, which the peers do not support."""
    arm = [joint.name for joint in robot.arm]
    path = robot.urdf.path_to(robot.ee_frame)
    return any(joint.mimic and joint.name not in (*arm, *robot.fixed_joints) for joint in path)
