"""Gravity torques of the arm's joints, and postures that the motors cannot hold."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import inlined, inner, kernel
from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import Tree, build_tree, flattened
from kinfeas.kinematics.self_collision import CollisionScratch, place_bodies
from kinfeas.robots.robot import Robot

GRAVITY = 9.81  # acceleration, m/s^2


class GravityModel(NamedTuple):
    """The masses that the arm's joints carry, and the torques that its motors can hold.

    A row of `load` has the mass of a joint's body, kg; that mass times its centre in the body's
    frame, three numbers, kg m; the mass of this body and all bodies beyond it, kg; and the largest
    gravity torque, N m or N, inf for no limit. One array, since each one slows down kernel calls.
    """

    tree: Tree  # all m joints that the arm drives, mimic joints included, as in `CollisionModel`
    load: Array  # shape (m, 6)
    variables: int  # number of the arm's joints

    @property
    def limited(self) -> bool:
        """Whether a joint has a largest gravity torque."""
        return bool(np.isfinite(self.load[:, _LIMIT]).any())


_MASS, _CARRIED, _LIMIT = 0, 4, 5


def build_gravity_model(robot: Robot) -> GravityModel:
    """Return the gravity model of `robot`, with all other joints at `robot.fixed_joints`.

    An arm joint has a limit if the robot has a `max_gravity_load`, the URDF has an effort limit
    above 0 for the joint, and the joint is not counterbalanced.
    """
    tree, mounts = build_tree(robot)
    load = np.zeros((len(tree.variable), 6))
    load[:, _LIMIT] = np.inf
    for name, mount in mounts.items():
        if mount.joint >= 0:
            link = robot.urdf.links[name]
            centre = mount.offset + mount.rotation @ link.centre
            load[mount.joint, :_CARRIED] += link.mass * np.array([1.0, *centre])
    load[:, _CARRIED] = load[:, _MASS]
    for i in range(len(load) - 1, -1, -1):
        if tree.parent[i] >= 0:
            load[tree.parent[i], _CARRIED] += load[i, _CARRIED]
    for arm_joint in robot.arm:
        joint = robot.urdf.joints[arm_joint.name]
        if robot.max_gravity_load and joint.effort and joint.name not in robot.counterbalanced:
            load[mounts[joint.child].joint, _LIMIT] = robot.max_gravity_load * joint.effort
    return GravityModel(tree, load, len(robot.arm))


class _Placed(NamedTuple):
    """Joint motions, and orientations and origins of the bodies, as in `CollisionScratch`."""

    motion: Array
    bodies: Array
    origins: Array


def gravity_torques(model: GravityModel, joint_positions: Array) -> Array:
    """Return the torques with which motors hold the arm at rest, shape (..., v), N m or N.

    These are generalized forces of the arm joints at positions (..., v), radians or metres, with
    the base level. They include the load of mimic joints.
    """
    flat, leading = flattened(model.variables, joint_positions)
    torque = np.empty_like(flat)
    _torque_batch(model.tree, model.load, flat, torque)
    return torque.reshape(*leading, model.variables)


def overloaded(model: GravityModel, joint_positions: Array) -> NDArray[np.bool_]:
    """Return which gravity torques exceed their limits at positions (..., v), shape (..., v)."""
    limit = np.full(model.variables, np.inf)
    np.minimum.at(limit, model.tree.variable, model.load[:, _LIMIT])
    return np.abs(gravity_torques(model, joint_positions)) > limit


@kernel
def _torque_batch(tree, load, joint_positions, out):
    joints = len(tree.variable)
    scratch = _Placed(np.empty((joints, 3)), np.empty((joints, 3, 3)), np.empty((joints, 3)))
    for i in range(len(joint_positions)):
        _write_torques(tree, load, joint_positions[i], scratch, out[i])


@inner
def overloads(tree: Tree, load, q, scratch: CollisionScratch):
    """Return whether a gravity torque exceeds its limit at the arm joints `q`, shape (v,).

    Tree and load are those of a `GravityModel`.
    """
    _write_torques(tree, load, q, scratch, scratch.torque)
    beyond = False
    for i in range(len(load)):
        beyond |= abs(scratch.torque[tree.variable[i]]) > load[i, _LIMIT]
    return beyond


@inlined
def _write_torques(tree, load, q, scratch, out):
    """Write the gravity torques of the arm joints, (v,): derivatives of the potential energy."""
    bodies, origins = scratch.bodies, scratch.origins
    place_bodies(tree, q, scratch)
    moment = scratch.motion  # first moments of mass, x and y; the motions are not needed any more
    for i in range(len(load)):
        for r in range(2):
            moment[i, r] = load[i, _MASS] * origins[i, r]
            for k in range(3):
                moment[i, r] += bodies[i, r, k] * load[i, 1 + k]
    for j in range(len(out)):
        out[j] = 0.0
    for i in range(len(load) - 1, -1, -1):
        carried = load[i, _CARRIED]
        force = carried * bodies[i, 2, 2]
        if not tree.prismatic[i]:
            x, y = moment[i, 0] - carried * origins[i, 0], moment[i, 1] - carried * origins[i, 1]
            force = bodies[i, 0, 2] * y - bodies[i, 1, 2] * x
        out[tree.variable[i]] += GRAVITY * tree.multiplier[i] * force
        if tree.parent[i] >= 0:
            for r in range(2):
                moment[tree.parent[i], r] += moment[i, r]
