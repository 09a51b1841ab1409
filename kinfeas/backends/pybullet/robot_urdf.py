"""The URDF that PyBullet gets: the robot's own, on planar joints and without idle ones."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from kinfeas.backends.pybullet.inertia import FRAME, mend_inertias, write_inertia
from kinfeas.backends.pybullet.merge_fixed_links import weld
from kinfeas.backends.pybullet.moving_joints import moving_joints
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.meshes import find_mesh
from kinfeas.robots.robot import Robot
from kinfeas.robots.xml_text import set_origin

MESH_FORMATS = (".stl", ".obj", ".dae")
"""What PyBullet reads; of STL files, the binary ones."""

PLANAR_JOINTS = ("planar_x_joint", "planar_y_joint", "planar_yaw_joint")
"""What the base stands on: it slides along the world's x and y, then turns."""

_WORLD, _CARRIERS = "planar_world_link", ("planar_x_link", "planar_y_link")
_AXES = ("1 0 0", "0 1 0", "0 0 1")


def physics_urdf(robot: Robot) -> tuple[str, dict[str, str]]:
    """Return the robot's URDF with three planar joints below its root.

    Joints that do not move here are fixed where the robot holds them, which is also how a brake
    holds them, and what they join is one link, but for the EE frame. None is left that follows
    another: PyBullet knows no such thing. Meshes go by their absolute paths.

    Returns:
        The URDF, and in which of its links each of the robot's links is, by name.

    Raises:
        KinfeasError: If a mesh is not there or PyBullet cannot read it, or a link that
            moves has a shape and no inertia.
    """
    xml = read_xml(robot.urdf_path, "robot").xml
    _place_meshes(xml, robot.urdf_path)
    moving = moving_joints(robot)
    for element in xml.findall("joint"):
        name = element.get("name")
        for mimic in element.findall("mimic"):
            element.remove(mimic)
        if robot.urdf.joints[name].moves and name not in moving:
            element.set("type", "fixed")
            set_origin(element, robot.urdf.joints[name].pose_at(robot.fixed_joints[name]))
    part_of = weld(xml, keep={robot.ee_frame})
    mend_inertias(xml, str(robot.urdf_path))
    for element in reversed(_planar_base(robot.urdf.root)):
        xml.insert(0, element)
    return ElementTree.tostring(xml, encoding="unicode"), part_of


def _place_meshes(robot: Any, urdf: Path) -> None:
    """Name every mesh by its absolute path, so that the text may be read from anywhere."""
    for link in robot.findall("link"):
        where = f"{urdf}: link {link.get('name')!r}, <mesh>"
        for mesh in link.iterfind("*/geometry/mesh"):
            path = find_mesh(Element(mesh, where), urdf.absolute().parent, MESH_FORMATS)
            mesh.set("filename", str(path))


def _planar_base(root: str) -> list[ElementTree.Element]:
    """Return the links and joints on which the link `root` moves over the floor."""
    elements = [_frame(name) for name in (_WORLD, *_CARRIERS)]
    parents, children = (_WORLD, *_CARRIERS), (*_CARRIERS, root)
    for name, axis, parent, child in zip(PLANAR_JOINTS, _AXES, parents, children, strict=True):
        joint = ElementTree.Element("joint", name=name)
        joint.set("type", "continuous" if name == PLANAR_JOINTS[-1] else "prismatic")
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=child)
        ElementTree.SubElement(joint, "axis", xyz=axis)
        # An upper limit below the lower one is PyBullet's word for none.
        ElementTree.SubElement(joint, "limit", lower="0", upper="-1", effort="0", velocity="0")
        elements.append(joint)
    return elements


def _frame(name: str) -> ElementTree.Element:
    """Return a link that is a mere frame."""
    link = ElementTree.Element("link", name=name)
    write_inertia(link, FRAME)
    return link
