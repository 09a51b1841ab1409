"""Pairs of links of which only the fitted primitives touch, not the parts that they replace."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from kinfeas.core.extras import require
from kinfeas.core.spatial import IDENTITY, Array, compose, rotation
from kinfeas.importer.boxed import Part
from kinfeas.importer.reach import pair_models, sampled
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.self_collision import CollisionModel, self_collides
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape

RELEVANT = 0.01
"""Fraction of configurations from which on a false contact matters."""

_COMPARED = 256  # configurations in which the parts of a pair are compared at most


def only_fitted(
    robot: Robot,
    originals: Mapping[str, Sequence[Part]],
    touching: Mapping[tuple[str, str], float],
) -> dict[tuple[str, str], float]:
    """Return the pairs of links that touch in relevant fractions only by their primitives.

    Their original parts touch in none of the configurations compared.

    Args:
        robot: Robot of primitives.
        originals: Parts that primitives replace, by link, as of `boxed_urdf`.
        touching: Checked pairs of links, and the fraction of configurations in which they touch.
    """
    suspected = {
        pair: fraction
        for pair, fraction in touching.items()
        if fraction >= RELEVANT and not originals.keys().isdisjoint(pair)
    }
    if not suspected:
        return {}
    require("fcl")
    joints = sampled(robot)

    @cache
    def solids(link: str) -> list[tuple[Any, Array]]:
        return [_solid(part) for part in originals.get(link, robot.urdf.links[link].shapes)]

    def placed(link: str, joints: Array) -> list[tuple[Any, Array]]:
        poses = forward(build_chain(replace(robot, ee_frame=link)), joints)
        return [
            (solid, compose(poses, np.broadcast_to(pose, poses.shape)))
            for solid, pose in solids(link)
        ]

    def touch(pair: tuple[str, str], alone: CollisionModel) -> bool:
        rows = np.flatnonzero(self_collides(alone, joints))
        some = joints[rows[:: -(-len(rows) // _COMPARED)]]
        parts = list(product(*(placed(link, some) for link in pair)))
        return any(_touch(first, second, i) for i in range(len(some)) for first, second in parts)

    return {
        pair: suspected[pair]
        for pair, alone in pair_models(robot)
        if pair in suspected and not touch(pair, alone)
    }


def _touch(first: tuple[Any, Array], second: tuple[Any, Array], i: int) -> bool:
    """Return whether two solids for FCL touch at their poses number `i`."""
    import fcl

    for solid, poses in (first, second):
        solid.setTransform(fcl.Transform(rotation(poses[i]).as_matrix(), poses[i, :3]))
    return bool(fcl.collide(first[0], second[0], fcl.CollisionRequest(), fcl.CollisionResult()))


def _solid(part: Part) -> tuple[Any, Array]:
    """Return a part for FCL and its pose in the frame of its link, shape (7,)."""
    import fcl

    if isinstance(part, Shape):
        kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
        return fcl.CollisionObject(kinds[part.kind](*part.size)), part.pose
    mesh = fcl.BVHModel()
    mesh.beginModel(len(part), 3 * len(part))
    mesh.addSubModel(part.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3))
    mesh.endModel()
    return fcl.CollisionObject(mesh), IDENTITY
