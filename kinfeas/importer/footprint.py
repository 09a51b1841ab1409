"""A root link on the floor, for robots whose own root lies above it."""

from collections.abc import Iterator
from itertools import chain, count
from xml.etree import ElementTree

import numpy as np

from kinfeas.importer.arm import Arm
from kinfeas.importer.placed import place
from kinfeas.robots.elements import parse_xml
from kinfeas.robots.urdf import Urdf, urdf_of

_PLAY = 0.02
"""Metres by which wheels may seem to stick in the floor, for primitives are larger than they."""


def on_the_floor(text: str, arm: Arm, source: str) -> tuple[str, float]:
    """Return the text of a URDF whose root is on the floor, and how far its own root is above it.

    The lowest shape that the arm does not carry stands on the floor. Where that is not below the
    root, the root is taken to be on the floor already, for wheels need not have shapes.

    Args:
        text: The URDF.
        arm: Its arm.
        source: Where it is from, for errors.
    """
    robot = parse_xml(text, "robot", source)
    urdf = urdf_of(robot)
    links = set(urdf.links) - urdf.below(arm.joints[0].name)
    down = np.array([0.0, 0.0, -1.0])
    depth = max((one.reach(down) for one in place(urdf, sorted(links), urdf.root, {})), default=0.0)
    if depth <= _PLAY:
        return text, 0.0
    height = round(depth, 3)
    name = next(_free_names(urdf))
    joint = ElementTree.Element("joint", name=_joint_of(name), type="fixed")
    ElementTree.SubElement(joint, "parent", link=name)
    ElementTree.SubElement(joint, "child", link=urdf.root)
    ElementTree.SubElement(joint, "origin", xyz=f"0 0 {height:g}", rpy="0 0 0")
    robot.xml.insert(0, joint)
    robot.xml.insert(0, ElementTree.Element("link", name=name))
    ElementTree.indent(robot.xml)
    return ElementTree.tostring(robot.xml, encoding="unicode", xml_declaration=True) + "\n", height


def _free_names(urdf: Urdf) -> Iterator[str]:
    """Yield names for a root and its joint that nothing has."""
    for name in chain(("base_footprint", "footprint"), map("footprint_{}".format, count(2))):
        if name not in urdf.links and _joint_of(name) not in urdf.joints:
            yield name


def _joint_of(link: str) -> str:
    return f"{link}_joint"
