"""What can move in a scene has an inertia, one that a body can have."""

from pathlib import Path

import numpy as np

from kinfeas.core.spatial import Array
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.tree import Urdf
from kinfeas.scenes.objects import moving_joint

MOMENTS = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}
"""Attributes of <inertia>, and where they stand in the matrix."""

SLACK = 1e-6
"""Share of a moment that is no more than a rounding."""


def check_inertia(path: Path, urdf: Urdf, *, fixed: bool) -> None:
    """Check that each link that can move has an <inertial> that physics engines can move.

    Args:
        path: The URDF.
        urdf: What it says.
        fixed: Whether its root link stays where it is.

    Raises:
        KinfeasError: If it has none, or no mass, or moments that no body has.
    """
    robot = read_xml(path, "robot")
    hangs = {joint.child for joint in urdf.joints.values() if not joint.moves}
    for link in robot.children("link"):
        name = link.text("name")
        if fixed and moving_joint(urdf, name) is None:
            continue
        named, inertial = Element(link.xml, f"{path}: link {name!r}"), link.child("inertial")
        if inertial is None:
            raise named.error("it can move, and <inertial> is missing")
        if urdf.links[name].mass > 0.0:
            _check_moments(named, read_moments(inertial.need("inertia")))
        elif name not in hangs:  # a frame may hang on what has a mass
            raise named.error("it can move, and its mass must be above 0")


def read_moments(inertia: Element) -> Array:
    """Return the moments that an element <inertia> says, shape (3, 3), kg m^2."""
    moments = np.zeros((3, 3))
    for name, (row, column) in MOMENTS.items():
        moments[row, column] = moments[column, row] = inertia.number(name, 0.0)
    return moments


def _check_moments(link: Element, moments: Array) -> None:
    small, middle, large = np.linalg.eigvalsh(moments)
    if small <= 0.0:
        raise link.error("it can move, and all principal moments of inertia must be above 0")
    if large - small - middle > SLACK * large:
        raise link.error(
            f"it can move, and its largest principal moment of inertia, {large:.3g}, must be at "
            f"most the sum of the other two, {small + middle:.3g}"
        )
