"""Distances from the base of a simulated robot to obstacles."""

import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from kinfeas.backends.mujoco.model import ROBOT, Model
from kinfeas.backends.physics.obstacles import Obstacle, Shape, is_beside, obstacles_around
from kinfeas.core.kernels import compiled
from kinfeas.core.motion import Rows
from kinfeas.core.spatial import Array
from kinfeas.kinematics.sensing import AS_NEAR

_OUTSIDE = 1e-3  # m before a corner where its ray starts
_SIDES = 16  # of a cylinder
_UNIT_BOX = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
_OTHERS = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # geom groups without the robot's


class Surroundings:
    """Measures the obstacles around the bases of a model's robots."""

    def __init__(self, model: Model) -> None:
        self._model, engine = model, model.engine
        owner, base = model.owner[engine.geom_bodyid], ~model.on_arm[engine.geom_bodyid]
        self._base = np.flatnonzero((owner == ROBOT) & base)
        spared = model.grasped[1] if model.grasp is not None else -1
        objects = (owner >= 0) & (engine.geom_bodyid != spared)
        self._objects = np.flatnonzero(objects)
        self._is_object = np.append(objects, False)  # the last one is what rays hit at -1
        data = mujoco.MjData(engine)
        data.qpos[:] = model.rest
        mujoco.mj_kinematics(engine, data)
        self._shapes = [
            Shape.around(corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
            for geom in self._base.tolist()
            if (corners := _corners(engine, geom)) is not None
        ]

    def around(self, batch: Any, row: int, data: Any, within: float) -> list[Obstacle]:
        """Return the obstacles within a distance (m) of the robot in a `row` of MuJoCo's `batch`.

        `data` are those of the row at the present positions.
        """
        engine, owner = self._model.engine, self._model.owner

        def cast(corners: Array, ahead: Array, height: float) -> Iterator[Obstacle]:
            starts = np.column_stack([corners + _OUTSIDE * ahead, np.full(len(corners), height)])
            rays = batch.ray(starts, [*ahead, 0.0], _OTHERS, ids=[row], normal=True)
            hits = zip(corners, *(values[0] for values in rays), strict=True)
            for corner, length, geom, normal in hits:
                entered = normal[:2] @ ahead < 0.0  # else it starts inside an object
                near = self._is_object[geom] and length <= within - _OUTSIDE
                if near and entered and is_beside(normal):
                    toward = -normal[:2]
                    distance = float((length + _OUTSIDE) * ahead @ toward)
                    yield Obstacle(corner, toward, distance, height)

        # Rigidly connected parts are one body in MuJoCo: of each part, a point is needed.
        nearest: dict[int, dict[tuple[int, int], Obstacle]] = {}
        for own, other, least in self._near(data, within):
            body = int(engine.geom_bodyid[other])
            points = nearest.setdefault(int(owner[body]), {})
            limits = [within, *(point.distance + AS_NEAR for point in points.values())]
            if (own, body) in points:
                limits.append(points[own, body].distance)
            farthest = min(limits)
            point = _closest(engine, data, own, other, farthest) if least < farthest else None
            if point is not None:
                points[own, body] = point
        x, y, heading = data.qpos[self._model.at[0, :3]].tolist()
        closest = ([*nearest[number].values()] for number in sorted(nearest))
        return obstacles_around((x, y, heading), closest, self._shapes, cast)

    def _near(self, data: Any, within: float) -> Iterator[tuple[int, int, float]]:
        """Return pairs of geoms of base and objects, and lower bounds of their distances.

        Pairs beyond `within` metres are left out; the nearest pairs come first.
        """
        engine, base, objects = self._model.engine, self._base, self._objects
        least = np.empty((len(base), len(objects)))
        boxes = data.geom_xpos, data.geom_xmat, engine.geom_aabb
        _distances_to_boxes(*boxes, base, objects, least)
        least -= engine.geom_rbound[base][:, np.newaxis]
        own, other = np.nonzero(least < within)
        near = least[own, other]
        for pair in near.argsort(kind="stable").tolist():
            yield int(base[own[pair]]), int(objects[other[pair]]), float(near[pair])


# Compiled on import: a period of a deployed robot cannot wait for it.
@compiled(
    ["void(f8[:,:], f8[:,:], f8[:,:], i8[:], i8[:], f8[:,:])"], "(g,p),(g,t),(g,s),(b),(k)->(b,k)"
)
def _distances_to_boxes(
    positions: Array, matrices: Array, boxes: Array, base: Rows, objects: Rows, out: Array
) -> None:
    """Write the distances from geoms `base` to the bounding boxes of `objects`, (b, k), metres.

    Positions, rotation matrices and boxes (centres and half sizes) are those of all geoms, shapes
    (g, 3), (g, 9) and (g, 6).
    """
    for i, own in enumerate(base):
        for k, other in enumerate(objects):
            squared = 0.0
            for axis in range(3):
                along = -boxes[other, axis]
                for j in range(3):
                    offset = positions[own, j] - positions[other, j]
                    along += matrices[other, 3 * j + axis] * offset
                beyond = max(abs(along) - boxes[other, 3 + axis], 0.0)
                squared += beyond * beyond
            out[i, k] = math.sqrt(squared)


def _closest(engine: Any, data: Any, own: int, other: int, within: float) -> Obstacle | None:
    """Return the nearest points of two geoms; None if beyond `within` or above each other."""
    ends = np.zeros((2, 3))
    distance = mujoco.mj_geomDistance(engine, data, own, other, within, ends.reshape(6))
    gap = np.sign(distance) * (ends[1] - ends[0])
    length = float(np.linalg.norm(gap))
    if distance >= within or length == 0.0 or not is_beside(gap / length):
        return None
    return Obstacle(ends[0, :2].copy(), gap[:2] / length, float(distance), float(ends[0, 2]))


def _corners(engine: Any, geom: int) -> Array | None:
    """Return the corners of a geom in its frame, shape (k, 3); None for a sphere."""
    kind, size = engine.geom_type[geom], engine.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _UNIT_BOX * size
    if kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        half = size[1] + (size[0] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0)
        angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
        circle = size[0] * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.vstack([np.column_stack([circle, np.full(_SIDES, z)]) for z in (-half, half)])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = engine.geom_dataid[geom]
        start = engine.mesh_vertadr[mesh]
        return np.asarray(engine.mesh_vert[start : start + engine.mesh_vertnum[mesh]])
    return None
