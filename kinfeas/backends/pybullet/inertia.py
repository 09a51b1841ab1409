"""Inertias of links: read, written, and made such as a body can have."""

from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.elements import Element
from kinfeas.robots.xml_text import numbers_text
from kinfeas.scenes.inertia import MOMENTS, SLACK, read_moments

_SMALLEST = 0.01
"""Radius of gyration of bodies whose file gives them none, metres."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Inertia of a link.

    Attributes:
        mass: kg.
        centre: Of mass, in the link's frame, shape (3,), metres.
        moments: About the centre along the link's axes, shape (3, 3), kg m^2.
    """

    mass: float
    centre: Array
    moments: Array

    def about(self, point: Array) -> Array:
        """Return the moments about a point (3,), by the parallel axis theorem, shape (3, 3)."""
        arm = self.centre - point
        moments: Array = self.moments + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return moments


FRAME = Inertia(0.001, np.zeros(3), 1e-6 * np.eye(3))
"""Of a link that is a mere frame: PyBullet would take it for 1 kg and 1 kg m^2."""


def read_inertia(link: Any) -> Inertia | None:
    """Return what the element <link> of a URDF says, None if it says nothing."""
    inertial = Element(link, "").child("inertial")
    if inertial is None:
        return None
    pose, moments = inertial.origin(), read_moments(inertial.need("inertia"))
    turn = rotation(pose).as_matrix()
    return Inertia(inertial.need("mass").number("value"), pose[:3], turn @ moments @ turn.T)


def write_inertia(link: Any, inertia: Inertia) -> None:
    """Put an inertia into an element <link>, in place of its own."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers_text(inertia.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(inertia.mass))
    moments = {name: repr(float(inertia.moments[at])) for name, at in MOMENTS.items()}
    ElementTree.SubElement(inertial, "inertia", moments)


def possible(inertia: Inertia) -> Inertia:
    """Return an inertia that a body can have: the same one, or with moments added about all axes.

    No principal moment of a body is larger than the other two together. Vendors' files break that,
    and PyBullet takes such a link for one without inertia, which flies off when it is touched.
    """
    small, middle, large = np.linalg.eigvalsh(inertia.moments)
    excess, none = large - small - middle, small <= 0.0
    if excess <= SLACK * large and not none:
        return inertia
    lacking = max(excess, inertia.mass * _SMALLEST**2 - small if none else 0.0) * (1.0 + SLACK)
    return replace(inertia, moments=inertia.moments + lacking * np.eye(3))


def mend_inertias(robot: Any, where: str) -> None:
    """Make the inertia of every link of the element <robot> one that a body can have.

    A link without an inertia is a mere frame, if it has no shape or hangs on a fixed joint. Links
    without mass stay.

    Args:
        robot: The element; it is changed.
        where: What an error begins with.

    Raises:
        KinfeasError: If another link has no inertia.
    """
    fixed = (joint for joint in robot.findall("joint") if joint.get("type") == "fixed")
    hangs = {joint.find("child").get("link") for joint in fixed}
    for link in robot.findall("link"):
        inertia = read_inertia(link)
        mended = FRAME if inertia is None else inertia
        shaped = any(link.find(tag) is not None for tag in ("visual", "collision"))
        if inertia is None and shaped and link.get("name") not in hangs:
            name = link.get("name")
            raise KinfeasError(f"{where}: link {name!r} can move, and <inertial> is missing")
        if mended.mass > 0.0:
            mended = possible(mended)
        if mended is not inertia:
            write_inertia(link, mended)
