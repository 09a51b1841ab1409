"""Shapes as collision objects of python-fcl; not thread-safe."""

from typing import Any

import fcl
import numpy as np

from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.urdf import Shape

_THINNEST = 1e-4  # m, of a shrunk shape


def fcl_object(part: Shape | Array, less: float = 0.0) -> Any:
    """Return a primitive at its pose, or the triangles of a mesh, shape (t, 3, 3), metres.

    `less` is the length by which a primitive shrinks along each of its axes, metres. Two shrunk
    primitives touch where the original ones overlap by more than `less`.
    """
    if isinstance(part, Shape):
        kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
        thinner = {"box": (less,) * 3, "cylinder": (less / 2.0, less), "sphere": (less / 2.0,)}
        size = np.maximum(np.subtract(part.size, thinner[part.kind]), _THINNEST)
        primitive = fcl.CollisionObject(kinds[part.kind](*size))
        place(primitive, part.pose)
        return primitive
    mesh = fcl.BVHModel()
    mesh.beginModel(len(part), 3 * len(part))
    mesh.addSubModel(part.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3))
    mesh.endModel()
    return fcl.CollisionObject(mesh)


def place(fcl_object: Any, pose: Array) -> None:
    """Move a collision object to a pose, shape (7,)."""
    fcl_object.setTransform(fcl.Transform(rotation(pose).as_matrix(), pose[:3]))


def touch(a: Any, b: Any) -> bool:
    """Return whether two collision objects touch."""
    return bool(fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()))
