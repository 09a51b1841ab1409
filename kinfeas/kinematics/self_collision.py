"""Collisions of a robot with itself and the floor, in batches of configurations, on primitives."""

import math
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import copy_row, inlined, inner, kernel
from kinfeas.core.solid_kernels import PRISM
from kinfeas.core.spatial import Array, rotation
from kinfeas.kinematics.convex import BOX, CYLINDER, SCRATCH_ROWS, SPHERE, closer_than
from kinfeas.kinematics.forward import Mount, Tree, build_tree, flattened, place_joints, turn_row
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape

MARGIN = 1e-3  # distance below which two shapes count as touching, metres

_KINDS = {"box": BOX, "cylinder": CYLINDER, "sphere": SPHERE}


class CollisionModel(NamedTuple):
    """The s collision shapes of a robot and the pairs of them that may touch."""

    tree: Tree  # all joints that the arm drives, mimic joints included
    body: NDArray[np.intp]  # joint of the shape's body, shape (s,); -1 is the base
    kind: NDArray[np.intp]  # shape kinds of `convex`, shape (s,)
    size: Array  # half extents, shape (s, 3), metres
    radius: Array  # radius of the bounding sphere, shape (s,), metres
    rotation: Array  # orientation of the shape in its body, shape (s, 3, 3)
    offset: Array  # position of its centre in its body, shape (s, 3), metres
    pairs: NDArray[np.uintp]  # indices of shapes to check, (p, 2); signed integers are slower
    variables: int  # number of the arm's joints
    apart: Array  # distance below which the shapes of a pair count as touching, (p,), metres
    above: NDArray[np.bool_]  # shapes that must stay above the floor, shape (s,)


class CollisionScratch(NamedTuple):
    """Memory of a check, allocated once for a whole batch; frames are those of the last check."""

    motion: Array  # of `place_joints`, shape (m, 3)
    bodies: Array  # orientations of the joints' bodies in the base frame, shape (m, 3, 3)
    origins: Array  # origins of the joints' bodies in the base frame, shape (m, 3), metres
    rotation: Array  # orientations of the shapes in the base frame, shape (s, 3, 3)
    position: Array  # centres of the shapes in the base frame, shape (s, 3), metres
    simplex: Array  # memory of `closer_than`
    solid: Array  # orientation, centre and half extents of a solid, shape (5, 3)
    prism: Array  # the same solid as a prism, shape (`PRISM`,)
    torque: Array  # gravity torques, shape (v,)


def build_collision_model(robot: Robot, clearance: float = 0.0) -> CollisionModel:
    """Return the collision model of `robot`, with all other joints at `robot.fixed_joints`.

    With a clearance, metres, a pair of shapes that keeps it at the robot's `home` must keep it in
    all configurations.

    The model has no pairs of shapes on one link, on links that are joined rigidly or by one joint,
    on links that the arm does not move against each other, or in `robot.ignored_collisions`.
    Shapes that the arm moves must stay above the floor if they are above it at `home`.
    """
    tree, mounts = build_tree(robot)
    named = [(link.name, shape) for link in robot.urdf.links.values() for shape in link.shapes]
    placed = [_mount_shape(mounts[link], shape) for link, shape in named]
    extents = [_extents(shape) for _, shape in named]
    shapes: dict[str, list[int]] = {}
    for i, (link, _) in enumerate(named):
        shapes.setdefault(link, []).append(i)
    pairs = sorted(
        (min(i, k), max(i, k))
        for link, other in checked_links(robot)
        for i, k in product(shapes[link], shapes[other])
    )
    model = CollisionModel(
        tree=tree,
        body=np.array([mount.joint for mount in placed], dtype=np.intp),
        kind=np.array([_KINDS[shape.kind] for _, shape in named], dtype=np.intp),
        size=np.array([half for half, _ in extents]).reshape(-1, 3),
        radius=np.array([radius for _, radius in extents]),
        rotation=np.array([mount.rotation for mount in placed]).reshape(-1, 3, 3),
        offset=np.array([mount.offset for mount in placed]).reshape(-1, 3),
        pairs=np.array(pairs, dtype=np.uintp).reshape(-1, 2),
        variables=len(robot.arm),
        apart=np.full(len(pairs), MARGIN),
        above=np.zeros(len(named), dtype=np.bool_),
    )
    home = robot.home["home"][np.newaxis]
    model = model._replace(above=_above_floor(model, home[0]))
    if clearance:
        for p in range(len(pairs)):
            wider = model._replace(pairs=model.pairs[[p]], apart=np.array([MARGIN + clearance]))
            model.apart[p] += 0.0 if self_collides(wider, home)[0] else clearance
    return model


def checked_links(robot: Robot) -> list[tuple[str, str]]:
    """Return the pairs of links with shapes that are checked, sorted by name."""
    rigid, bodies = robot.urdf.rigid, dict[int, list[str]]()
    for link, mount in build_tree(robot)[1].items():
        if robot.urdf.links[link].shapes:
            bodies.setdefault(mount.joint, []).append(link)
    joined = {
        frozenset((rigid[joint.parent], rigid[joint.child])) for joint in robot.urdf.joints.values()
    }
    return sorted(
        (min(a, b), max(a, b))
        for links, others in combinations(bodies.values(), 2)
        for a, b in product(links, others)
        if rigid[a] != rigid[b]
        and frozenset((rigid[a], rigid[b])) not in joined
        and frozenset((a, b)) not in robot.ignored_collisions
    )


def self_collides(model: CollisionModel, joint_positions: Array) -> NDArray[np.bool_]:
    """Return whether the robot touches itself or the floor, shape (...).

    Joint positions are those of the arm, shape (..., v), radians or metres.
    """
    flat, leading = flattened(model.variables, joint_positions)
    touching = np.empty(len(flat), dtype=np.bool_)
    _self_collides_batch(model, flat, touching)
    return touching.reshape(leading)


@kernel
def _self_collides_batch(model, joint_positions, touching):
    scratch = make_collision_scratch(model)
    for i in range(len(joint_positions)):
        touching[i] = touches_itself(model, joint_positions[i], scratch)


@kernel
def _above_floor(model, q):
    scratch = make_collision_scratch(model)
    place_shapes(model, q, scratch)
    above = np.empty(len(model.body), dtype=np.bool_)
    for s in range(len(model.body)):
        above[s] = model.body[s] >= 0 and _lowest(model, s, scratch) >= MARGIN
    return above


@kernel
def make_collision_scratch(model):
    """Return scratch memory with the poses of the shapes on the base."""
    joints, shapes = len(model.tree.variable), len(model.body)
    scratch = CollisionScratch(
        np.empty((joints, 3)), np.empty((joints, 3, 3)), np.empty((joints, 3)),
        np.empty((shapes, 3, 3)), np.empty((shapes, 3)),
        np.empty((SCRATCH_ROWS, 3)), np.empty((5, 3)), np.empty(PRISM), np.empty(model.variables),
    )  # fmt: skip
    for s in range(shapes):
        if model.body[s] < 0:
            copy_row(model.offset[s], scratch.position[s])
            for r in range(3):
                copy_row(model.rotation[s, r], scratch.rotation[s, r])
    return scratch


@inner
def touches_itself(model: CollisionModel, q, scratch: CollisionScratch):
    """Return whether the robot touches itself or the floor at the arm joints `q`, shape (v,)."""
    place_shapes(model, q, scratch)
    for s in range(len(model.body)):
        if model.above[s] and _lowest(model, s, scratch) < MARGIN:
            return True
    rot, pos, size = scratch.rotation, scratch.position, model.size
    for p in range(len(model.pairs)):
        a, b = model.pairs[p, 0], model.pairs[p, 1]
        dx, dy, dz = pos[b, 0] - pos[a, 0], pos[b, 1] - pos[a, 1], pos[b, 2] - pos[a, 2]
        reach = model.radius[a] + model.radius[b] + model.apart[p]
        if dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        if _sphere_misses_box(dx, dy, dz, model.radius[b] + model.apart[p], rot[a], size[a]):
            continue
        if _sphere_misses_box(dx, dy, dz, model.radius[a] + model.apart[p], rot[b], size[b]):
            continue
        if closer_than(
            model.apart[p],
            model.kind[a], size[a], rot[a], pos[a],
            model.kind[b], size[b], rot[b], pos[b],
            scratch.simplex,
        ):  # fmt: skip
            return True
    return False


@inlined
def place_shapes(model, q, scratch):
    """Write orientation and centre of the shapes that the arm moves, in the base frame."""
    place_bodies(model.tree, q, scratch)
    for s in range(len(model.body)):
        if model.body[s] >= 0:
            _place_shape(model, s, scratch)


@inlined
def place_bodies(tree, q, scratch):
    """Write orientation and origin of every joint's body in the base frame."""
    motion, bodies, origins = scratch.motion, scratch.bodies, scratch.origins
    place_joints(tree, q, motion)
    for i in range(len(tree.variable)):
        parent = tree.parent[i]
        for r in range(3):
            a, b, c = 1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0
            origin = 0.0
            if parent >= 0:
                a, b, c = bodies[parent, r, 0], bodies[parent, r, 1], bodies[parent, r, 2]
                origin = origins[parent, r]
            origin += a * tree.offset[i, 0] + b * tree.offset[i, 1] + c * tree.offset[i, 2]
            a, b, c = turn_row(a, b, c, tree.rotation[i], motion[i, 0], motion[i, 1])
            bodies[i, r, 0], bodies[i, r, 1], bodies[i, r, 2] = a, b, c
            origins[i, r] = origin + c * motion[i, 2]


@inlined
def _place_shape(model, s, scratch):
    body, offset, out = model.body[s], model.offset, scratch.rotation
    for r in range(3):
        a, b, c = scratch.bodies[body, r, 0], scratch.bodies[body, r, 1], scratch.bodies[body, r, 2]
        shift = a * offset[s, 0] + b * offset[s, 1] + c * offset[s, 2]
        scratch.position[s, r] = scratch.origins[body, r] + shift
        a, b, c = turn_row(a, b, c, model.rotation[s], 1.0, 0.0)
        out[s, r, 0], out[s, r, 1], out[s, r, 2] = a, b, c


@inlined
def _lowest(model, s, scratch):
    """Return the height of the lowest point of a shape where `place_shapes` has put it, metres."""
    x, y, z = scratch.rotation[s, 2]
    half = model.size[s]
    if model.kind[s] == BOX:
        below = abs(x) * half[0] + abs(y) * half[1] + abs(z) * half[2]
    elif model.kind[s] == CYLINDER:
        below = math.sqrt(x * x + y * y) * half[0] + abs(z) * half[2]
    else:
        below = half[0]
    return scratch.position[s, 2] - below


@inlined
def _sphere_misses_box(dx, dy, dz, radius, rot, half):
    """Return whether a sphere and a box are apart; (dx, dy, dz) is between their centres."""
    squared = 0.0
    for k in range(3):
        along = abs(rot[0, k] * dx + rot[1, k] * dy + rot[2, k] * dz) - half[k]
        if along > 0.0:
            squared += along * along
    return squared > radius * radius


def _mount_shape(mount: Mount, shape: Shape) -> Mount:
    matrix = rotation(shape.pose).as_matrix()
    offset = mount.offset + mount.rotation @ shape.pose[:3]
    return Mount(mount.joint, mount.rotation @ matrix, offset)


def _extents(shape: Shape) -> tuple[Array, float]:
    """Return the half extents (3,) and the radius of the bounding sphere, metres."""
    half = shape.half
    radius = {"box": np.linalg.norm(half), "cylinder": np.hypot(*half[1:]), "sphere": half[0]}
    return half, float(radius[shape.kind])
