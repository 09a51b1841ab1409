"""Links that cannot move against each other become one: a physics step costs by the link."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kinfeas.robots.elements import Element
from kinfeas.robots.xml_text import numbers_text, set_origin
from kinfeas.spatial import Array, compose, rotation

_MOMENTS = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}


@dataclass(frozen=True, eq=False)
class _Mass:
    """Inertia of a link.

    Attributes:
        mass: kg.
        centre: Of mass, in the link's frame, shape (3,), metres.
        moments: About the centre along the link's axes, shape (3, 3), kg m^2.
    """

    mass: float
    centre: Array
    moments: Array


def weld(robot: Any, keep: Collection[str]) -> dict[str, str]:
    """Let every link that hangs on a fixed joint become part of the link that it hangs on.

    Args:
        robot: The element <robot> of a URDF that has been checked; it is changed.
        keep: Names of links that stay of their own.

    Returns:
        The link that each link, by its name, is part of now; for most of them that is itself.
    """
    links = {link.get("name"): link for link in robot.findall("link")}
    part_of = {name: name for name in links}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        if joint.get("type") != "fixed" or child in keep:
            continue
        pose = Element(joint, "").origin()
        _add(links[parent], links[child], pose)
        for other in robot.findall("joint"):
            stands_on = other.find("parent")
            if stands_on.get("link") == child:
                stands_on.set("link", parent)
                set_origin(other, compose(pose, Element(other, "").origin()))
        robot.remove(joint)
        robot.remove(links[child])
        part_of = {name: parent if of == child else of for name, of in part_of.items()}
    return part_of


def _add(link: Any, part: Any, pose: Array) -> None:
    """Add what `part` weighs and looks like to a link in whose frame it has the pose."""
    for tag in ("visual", "collision"):
        for element in part.findall(tag):
            set_origin(element, compose(pose, Element(element, "").origin()))
            link.append(element)
    own, added = _mass(link), _mass(part)
    if added is None:
        return
    turn = rotation(pose).as_matrix()
    moved = _Mass(added.mass, pose[:3] + turn @ added.centre, turn @ added.moments @ turn.T)
    _set_mass(link, moved if own is None else _sum(own, moved))


def _sum(one: _Mass, other: _Mass) -> _Mass:
    mass = one.mass + other.mass
    if mass == 0.0:
        return one
    centre = (one.mass * one.centre + other.mass * other.centre) / mass
    moments = sum(_about(part, centre) for part in (one, other))
    return _Mass(mass, centre, np.asarray(moments))


def _about(part: _Mass, point: Array) -> Array:
    """Return the moments about a point, by the parallel axis theorem, shape (3, 3)."""
    arm = part.centre - point
    moments: Array = part.moments + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return moments


def _mass(link: Any) -> _Mass | None:
    inertial = Element(link, "").child("inertial")
    if inertial is None:
        return None
    pose, moments = inertial.origin(), np.zeros((3, 3))
    inertia = inertial.need("inertia")
    for name, (row, column) in _MOMENTS.items():
        moments[row, column] = moments[column, row] = inertia.number(name, 0.0)
    turn = rotation(pose).as_matrix()
    return _Mass(inertial.need("mass").number("value"), pose[:3], turn @ moments @ turn.T)


def _set_mass(link: Any, mass: _Mass) -> None:
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers_text(mass.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(mass.mass))
    moments = {name: repr(float(mass.moments[at])) for name, at in _MOMENTS.items()}
    ElementTree.SubElement(inertial, "inertia", moments)
