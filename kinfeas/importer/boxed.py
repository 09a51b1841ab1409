"""A URDF of primitives: the links and joints of another one, its meshes boxed in."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from kinfeas.config import no_such
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose, rotation
from kinfeas.importer.meshes import read_triangles
from kinfeas.importer.placed import link_pose
from kinfeas.importer.primitives import MARGIN, fit_primitives
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.urdf import Joint, Shape, Urdf, read_shape, urdf_of
from kinfeas.robots.xml_text import numbers_text, set_origin

_DIGITS = 4
"""Of lengths in metres and of angles: what they take away is less than what `MARGIN` adds."""

assert MARGIN > 10.0**-_DIGITS

_THINNEST = 10.0**-_DIGITS  # m, of which rounding leaves something

_COLOURS = ("0.78 0.8 0.83 1", "0.45 0.6 0.77 1")
"""Of links that are an even and an odd number of joints away from the root."""

_SHAPES = ("collision", "visual")
_SLANT = 1e-3  # cosine of an angle that is still a right one


def boxed_urdf(
    path: Path, base: str | None = None, on_link: Callable[[str], None] | None = None
) -> str:
    """Return the text of a URDF that needs no other file: all of its shapes are primitives.

    Links and joints stay as they are, with their inertias. Each collision mesh becomes one to four
    primitives that hold it; where links that are joined rigidly have no collision shape among them,
    their visual ones stand in. What is seen is what collides.

    Args:
        path: The robot's own URDF.
        base: The link that becomes the root, with what it carries; by default the one to which
            joints lead that slide and turn mere frames on the floor, as simulators hang robots up.
        on_link: Called with the name of each link that is done.

    Raises:
        KinfeasError: If the URDF is broken, has no link `base`, or a mesh cannot be read.
    """
    robot = read_robot_element(path)
    urdf = urdf_of(robot)
    links = {link.text("name"): link for link in robot.children("link")}
    kept = carried(urdf, _first_body(urdf, links) if base is None else base, str(path))
    colliding = {name for name, link in links.items() if link.child("collision")}
    out = ElementTree.Element("robot", name=urdf.name)
    for name in filter(kept.__contains__, links):
        link = Element(links[name].xml, f"{path}: link {name!r}")
        kind = "collision" if urdf.rigid[name] & colliding else "visual"
        shapes = _shapes(link, kind, path.absolute().parent)
        turned = sum(joint.moves for joint in urdf.path_to(name))
        out.append(_link(name, link.xml.find("inertial"), shapes, _COLOURS[turned % 2]))
        if on_link is not None:
            on_link(name)
    for joint in robot.children("joint"):
        if urdf.joints[joint.text("name")].parent in kept:
            out.append(joint.xml)
    ElementTree.indent(out)
    return ElementTree.tostring(out, encoding="unicode", xml_declaration=True) + "\n"


def read_robot_element(path: Path) -> Element:
    """Return the element <robot> of a URDF.

    Raises:
        KinfeasError: If it cannot be read, or is xacro that has yet to become a URDF.
    """
    robot = read_xml(path, "robot")
    if any("xacro}" in element.tag for element in robot.xml.iter()):
        raise robot.error("it is xacro and not yet a URDF: make one with xacro FILE > FILE.urdf")
    return robot


def _first_body(urdf: Urdf, links: Mapping[str, Element]) -> str:
    """Return the root, or the link to which joints lead from it that stand for a floor."""
    link, slides = urdf.root, False
    while True:
        group = urdf.rigid[link]
        bare = not any(links[name].child(kind) for name in group for kind in _SHAPES)
        moving = [joint for name in group for joint in urdf.on[name] if joint.moves]
        if not bare or len(moving) != 1 or not _on_a_floor(urdf, moving[0]):
            return link if slides else urdf.root
        link, slides = moving[0].child, slides or moving[0].kind == "prismatic"


def _on_a_floor(urdf: Urdf, joint: Joint) -> bool:
    """Return whether a joint moves as a base can: it slides across the floor, or turns on it."""
    upright = abs(float(rotation(link_pose(urdf, joint.child, {})).apply(joint.axis)[2]))
    return upright < _SLANT if joint.kind == "prismatic" else upright > 1.0 - _SLANT


def carried(urdf: Urdf, link: str, source: str) -> frozenset[str]:
    """Return a link and all that it carries.

    Raises:
        KinfeasError: If there is no such link.
    """
    if link not in urdf.links:
        raise KinfeasError(f"{source}: there is no link {link!r}{no_such(link, urdf.links)}")
    return frozenset({link}).union(*(urdf.below(joint.name) for joint in urdf.on[link]))


def _shapes(link: Element, kind: str, folder: Path) -> Iterable[Shape]:
    for element in link.children(kind):
        if own := read_shape(element):
            yield own
            continue
        mesh = element.need("geometry").need("mesh")
        pose = element.origin()
        for shape in fit_primitives(read_triangles(mesh, folder)):
            yield Shape(shape.kind, shape.size, compose(pose, shape.pose))


def _link(name: str, inertial: Any, shapes: Iterable[Shape], colour: str) -> ElementTree.Element:
    link = ElementTree.Element("link", name=name)
    if inertial is not None:
        link.append(inertial)
    for shape in shapes:
        for tag in ("visual", "collision"):
            element = ElementTree.SubElement(link, tag)
            set_origin(element, shape.pose, _DIGITS)
            geometry = ElementTree.SubElement(element, "geometry")
            ElementTree.SubElement(geometry, shape.kind, _size(shape))
            if tag == "visual":
                material = ElementTree.SubElement(element, "material", name=f"of_{name}")
                ElementTree.SubElement(material, "color", rgba=colour)
    return link


def _size(shape: Shape) -> dict[str, str]:
    sizes = [max(size, _THINNEST) for size in shape.size]
    if shape.kind == "box":
        return {"size": numbers_text(sizes, _DIGITS)}
    names = ("radius", "length")
    return {name: numbers_text([size], _DIGITS) for name, size in zip(names, sizes, strict=False)}
