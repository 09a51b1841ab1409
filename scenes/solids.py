"""Exact collisions of primitives, by python-fcl."""

from collections.abc import Iterable
from typing import Any

from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.tree import Shape

_THINNEST = 1e-4  # m, of what is left of a shape that is made smaller


class Solids:
    """Shapes in space, looked at as one; not for several threads at once.

    Args:
        shapes: Primitives with their poses in one frame.
        less: How much smaller to take them from side to side, metres: two groups that are taken
            `less` smaller touch where the shapes reach into each other by more than that.
    """

    def __init__(self, shapes: Iterable[Shape], less: float = 0.0) -> None:
        import fcl

        self._fcl = fcl
        self._objects = [_solid(fcl, shape, less) for shape in shapes]
        self._group = fcl.DynamicAABBTreeCollisionManager()
        self._group.registerObjects(self._objects)
        self._group.setup()

    def place(self, rotations: Array, positions: Array) -> None:
        """Move the k shapes, whose poses turn into `rotations` (k, 3, 3) and `positions` (k, 3)."""
        for solid, turn, place in zip(self._objects, rotations, positions, strict=True):
            solid.setTransform(self._fcl.Transform(turn, place))
        self._group.update()

    def touches(self, other: "Solids") -> bool:
        """Return whether any shape touches one of the `other` group."""
        found = self._fcl.CollisionData()
        self._group.collide(other._group, found, self._fcl.defaultCollisionCallback)
        return bool(found.result.is_collision)


def _solid(fcl: Any, shape: Shape, less: float) -> Any:
    kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
    thinner = {"box": (less,) * 3, "cylinder": (less / 2.0, less), "sphere": (less / 2.0,)}
    size = [
        max(full - part, _THINNEST)
        for full, part in zip(shape.size, thinner[shape.kind], strict=True)
    ]
    placed = fcl.Transform(rotation(shape.pose).as_matrix(), shape.pose[:3])
    return fcl.CollisionObject(kinds[shape.kind](*size), placed)
