"""A root link on the floor, for robots whose own root lies above it."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from kinfeas.draft.arm import Arm
from kinfeas.draft.placed import place
from kinfeas.robots.elements import read_xml
from kinfeas.robots.urdf import parse_urdf

_PLAY = 0.02
"""Metres by which wheels may seem to stick in the floor, for primitives are larger than they."""

_NAMES = ("base_footprint", "footprint", "kinfeas_footprint")


def on_the_floor(path: Path, arm: Arm) -> tuple[str, float]:
    """Return the text of a URDF whose root is on the floor, and how far its own root is above it.

    The lowest shape that the arm does not carry stands on the floor. Where that is not below the
    root, the root is taken to be on the floor already, for wheels need not have shapes.

    Args:
        path: The URDF.
        arm: Its arm.
    """
    urdf, text = parse_urdf(path), path.read_text(encoding="utf-8")
    links = set(urdf.links) - urdf.below(arm.joints[0].name)
    down = np.array([0.0, 0.0, -1.0])
    depth = max((one.reach(down) for one in place(urdf, sorted(links), urdf.root, {})), default=0.0)
    if depth <= _PLAY:
        return text, 0.0
    height = round(depth, 3)
    robot = read_xml(path, "robot").xml
    name = next(name for name in _NAMES if name not in urdf.links)
    joint = ElementTree.Element("joint", name=f"{name}_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=name)
    ElementTree.SubElement(joint, "child", link=urdf.root)
    ElementTree.SubElement(joint, "origin", xyz=f"0 0 {height:g}", rpy="0 0 0")
    robot.insert(0, joint)
    robot.insert(0, ElementTree.Element("link", name=name))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n", height
