"""Links that cannot move against each other become one: a physics step costs by the link."""

from collections.abc import Collection
from typing import Any

import numpy as np

from kinfeas.backends.pybullet.inertia import Inertia, read_inertia, write_inertia
from kinfeas.core.spatial import Array, compose, rotation
from kinfeas.robots.elements import Element
from kinfeas.robots.xml_text import set_origin


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
    own, added = read_inertia(link), read_inertia(part)
    if added is None:
        return
    turn = rotation(pose).as_matrix()
    moved = Inertia(added.mass, pose[:3] + turn @ added.centre, turn @ added.moments @ turn.T)
    write_inertia(link, moved if own is None else _sum(own, moved))


def _sum(one: Inertia, other: Inertia) -> Inertia:
    mass = one.mass + other.mass
    if mass == 0.0:
        return one
    centre = (one.mass * one.centre + other.mass * other.centre) / mass
    moments = sum(part.about(centre) for part in (one, other))
    return Inertia(mass, centre, np.asarray(moments))
