"""Checks of a scene: positions, overlaps by python-fcl, and inertias."""

from collections.abc import Mapping
from itertools import combinations, product
from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.fcl_shapes import fcl_object, touch
from kinfeas.robots.urdf import Urdf
from kinfeas.robots.urdf_file import SLACK, read_moments
from kinfeas.scenes.objects import SceneObject, moving_joint

_DOWN = np.array([0.0, 0.0, -1.0])
OVERLAP = 1e-3  # metres by which two objects may overlap, as where one is on the other


def check_layout(
    source: str, size: tuple[float, float], objects: Mapping[str, SceneObject]
) -> None:
    """Raise an error unless objects are on a floor of some size, metres, and do not overlap."""
    for name, scene_object in objects.items():
        where, (x, y) = f"{source}: object {name!r}", scene_object.pose[:2]
        if abs(x) > size[0] / 2.0 or abs(y) > size[1] / 2.0:
            raise KinfeasError(
                f"{where} is at ({x:g}, {y:g}), off the floor of {size[0]:g} x {size[1]:g} m"
            )
        sunk = max((shape.reach(_DOWN) for _, shape in scene_object.shapes()), default=0.0)
        if sunk > OVERLAP:
            raise KinfeasError(f"{where} is {sunk:.3g} m below the floor")
    solids = {
        name: [fcl_object(shape, OVERLAP) for _, shape in scene_object.shapes()]
        for name, scene_object in objects.items()
    }
    for a, b in combinations(objects, 2):
        if any(touch(*pair) for pair in product(solids[a], solids[b])):
            raise KinfeasError(
                f"{source}: objects {a!r} and {b!r} overlap by more than {1000.0 * OVERLAP:g} mm"
            )


def check_inertia(path: Path, urdf: Urdf, *, fixed: bool) -> None:
    """Check that each link that can move has a mass and plausible moments of inertia.

    `fixed` is whether the root link of the URDF at `path` is fixed to the world.
    """
    robot = read_xml(path, "robot")
    attached = {joint.child for joint in urdf.joints.values() if not joint.moves}
    for link in robot.children("link"):
        name = link.text("name")
        if fixed and moving_joint(urdf, name) is None:
            continue
        named, inertial = Element(link.xml, f"{path}: link {name!r}"), link.child("inertial")
        if inertial is None:
            raise named.error("a moving link needs <inertial>")
        if urdf.links[name].mass > 0.0:
            _check_moments(named, read_moments(inertial.need("inertia")))
        elif name not in attached:  # frames on a link with mass need none
            raise named.error("a moving link needs a mass above 0")


def _check_moments(link: Element, moments: Array) -> None:
    small, middle, large = np.linalg.eigvalsh(moments)
    if small <= 0.0:
        raise link.error("all principal moments of inertia must be above 0")
    if large - small - middle > SLACK * large:
        raise link.error(
            f"the largest principal moment of inertia, {large:.3g}, must be at most the sum of the "
            f"other two, {small + middle:.3g}"
        )
