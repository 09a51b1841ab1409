"""Visible shapes of a physics world, for pictures."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from kinfeas.backends.physics.robot import physics_urdf
from kinfeas.robots.elements import Element, parse_xml, read_xml
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape
from kinfeas.robots.urdf_file import read_shapes
from kinfeas.scenes.scene import Scene

ROBOT = ""
"""Stands for the robot in place of the name of an object."""

LinkName = tuple[str, str]
"""Name of an object, or `ROBOT`, and of a link."""

GREY = "#b3b3b3"
"""Colour of shapes without a material."""


class VisualShape(NamedTuple):
    """A visible primitive of a link, in its frame, and its colour, `#rrggbb` or `#rrggbbaa`."""

    link: LinkName
    shape: Shape
    colour: str


def visual_shapes(robot: Robot, scene: Scene | None) -> list[VisualShape]:
    """Return the visible primitives of robot and scene; meshes are left out."""
    urdf, _ = physics_urdf(robot)
    shapes = list(urdf_visuals(ROBOT, parse_xml(urdf, "robot", str(robot.urdf_path))))
    for name, item in scene.objects.items() if scene else ():
        shapes += urdf_visuals(name, read_xml(item.urdf_path, "robot"))
    return shapes


def urdf_visuals(owner: str, urdf: Element) -> Iterator[VisualShape]:
    """Return the visible primitives of a URDF, whose object is named `owner`."""
    colours = {item.get("name"): _colour(item) for item in urdf.xml.findall("material")}
    for link in urdf.children("link"):
        for visual in link.children("visual"):
            material = visual.xml.find("material")
            colour = None if material is None else _colour(material)
            if material is not None and colour is None:
                colour = colours.get(material.get("name"))
            for shape in read_shapes(visual):
                yield VisualShape((owner, link.text("name")), shape, colour or GREY)


def _colour(material: Any) -> str | None:
    colour = material.find("color")
    if colour is None:
        return None
    red, green, blue, *_ = map(float, colour.get("rgba").split())
    return "#" + bytes(round(255.0 * fraction) for fraction in (red, green, blue)).hex()
