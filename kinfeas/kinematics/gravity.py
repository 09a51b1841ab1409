"""Gravity torques of the arm's joints, and postures that the motors cannot hold."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import Tree, build_tree, flattened
from kinfeas.kinematics.kernels import inlined, inner, kernel
from kinfeas.kinematics.self_collision import CollisionScratch, place_bodies
from kinfeas.robots.robot import Robot

GRAVITY = 9.81
"""Acceleration, m/s^2."""


class GravityModel(NamedTuple):
    """The masses that the arm's joints carry, and the torques that its motors can hold.

    Attributes:
        tree: All m joints that the arm drives, mimic joints included, as in `CollisionModel`.
        mass: Of the body of each joint, shape (m,), kg.
        moment: The same times its centre, in its frame, shape (m, 3), kg m.
        carried: Mass of all bodies from each joint on, shape (m,), kg.
        limit: Largest gravity torque of each arm joint, shape (v,), N m or N; inf for none.
    """

    tree: Tree
    mass: Array
    moment: Array
    carried: Array
    limit: Array


def build_gravity_model(robot: Robot) -> GravityModel:
    """Return the gravity model of `robot`, with all other joints at `robot.fixed_joints`.

    Joints have a limit if the robot has a `max_gravity_load`, they have an effort limit, which is
    not 0, in the URDF, and are not counterbalanced.
    """
    tree, mounts = build_tree(robot)
    mass, moment = np.zeros(len(tree.variable)), np.zeros((len(tree.variable), 3))
    for name, mount in mounts.items():
        if mount.joint >= 0:
            link = robot.urdf.links[name]
            mass[mount.joint] += link.mass
            moment[mount.joint] += link.mass * (mount.offset + mount.rotation @ link.centre)
    carried = mass.copy()
    for i in range(len(mass) - 1, -1, -1):
        if tree.parent[i] >= 0:
            carried[tree.parent[i]] += carried[i]
    limit = np.full(len(robot.arm), np.inf)
    for j, joint in enumerate(robot.arm):
        effort = robot.urdf.joints[joint.name].effort
        if robot.max_gravity_load and effort and joint.name not in robot.counterbalanced:
            limit[j] = robot.max_gravity_load * effort
    return GravityModel(tree, mass, moment, carried, limit)


class _Placed(NamedTuple):
    """Joint motions, and orientations and origins of the bodies, as in `CollisionScratch`."""

    motion: Array
    bodies: Array
    origins: Array


def gravity_torques(model: GravityModel, joint_positions: Array) -> Array:
    """Return the torques with which motors hold the arm at rest, shape (..., v), N m or N.

    They are the generalized forces of the arm joints, those of joints that mimic them included, at
    positions (..., v), radians or metres, with the base level.
    """
    flat, leading = flattened(len(model.limit), joint_positions)
    torque = np.empty_like(flat)
    _torque_batch(model, flat, torque)
    return torque.reshape(*leading, len(model.limit))


def overloaded(model: GravityModel, joint_positions: Array) -> NDArray[np.bool_]:
    """Return which gravity torques exceed their limits at positions (..., v), shape (..., v)."""
    beyond: NDArray[np.bool_] = np.abs(gravity_torques(model, joint_positions)) > model.limit
    return beyond


@kernel
def _torque_batch(model, joint_positions, out):
    joints = len(model.tree.variable)
    scratch = _Placed(np.empty((joints, 3)), np.empty((joints, 3, 3)), np.empty((joints, 3)))
    for i in range(len(joint_positions)):
        _write_torques(model, joint_positions[i], scratch, out[i])


@inner
def overloads(model: GravityModel, q, scratch: CollisionScratch):
    """Return whether a gravity torque exceeds its limit at the arm joints `q`, shape (v,)."""
    _write_torques(model, q, scratch, scratch.torque)
    beyond = False
    for j in range(len(q)):
        beyond |= abs(scratch.torque[j]) > model.limit[j]
    return beyond


@inlined
def _write_torques(model, q, scratch, out):
    """Write the gravity torques of the arm joints, shape (v,): derivatives of the energy."""
    tree, bodies, origins = model.tree, scratch.bodies, scratch.origins
    place_bodies(tree, q, scratch)
    moment = scratch.motion  # x and y; bodies are placed, their joints' motions are not needed
    for i in range(len(tree.variable)):
        for r in range(2):
            moment[i, r] = model.mass[i] * origins[i, r]
            for k in range(3):
                moment[i, r] += bodies[i, r, k] * model.moment[i, k]
    for j in range(len(out)):
        out[j] = 0.0
    for i in range(len(tree.variable) - 1, -1, -1):
        force = model.carried[i] * bodies[i, 2, 2]
        if not tree.prismatic[i]:
            x = moment[i, 0] - model.carried[i] * origins[i, 0]
            y = moment[i, 1] - model.carried[i] * origins[i, 1]
            force = bodies[i, 0, 2] * y - bodies[i, 1, 2] * x
        out[tree.variable[i]] += GRAVITY * tree.multiplier[i] * force
        if tree.parent[i] >= 0:
            for r in range(2):
                moment[tree.parent[i], r] += moment[i, r]
