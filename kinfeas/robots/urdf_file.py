"""Reading of URDF files, with checks."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import Array, compose, make_pose
from kinfeas.robots.elements import LARGEST, Element, read_xml
from kinfeas.robots.urdf import Joint, JointKind, Link, Mimic, Shape, Urdf, descendants

MOMENTS = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
"""Attributes of <inertia>, and their row and column."""

SLACK = 1e-6  # fraction of a principal moment that counts as rounding
_MAX_MASS, _MAX_MOMENT = 1e5, 1e7  # kg and kg m^2

_BASE_JOINTS = ("planar", "floating")


def parse_urdf(path: Path) -> Urdf:
    """Return the links and joints of a robot's URDF file."""
    return urdf_of(read_robot_xml(path))


def read_robot_xml(path: Path) -> Element:
    """Return the element <robot> of a robot's URDF, `without_base_joints`."""
    return without_base_joints(read_xml(path, "robot"))


def without_base_joints(robot: Element) -> Element:
    """Remove the links above the base from an element <robot>, and return it.

    These are links without shapes, from the root down to the last planar or floating joint, which
    represents the motion of the base.
    """
    links = {link.get("name"): link for link in robot.xml.findall("link")}
    on: dict[Any, list[Any]] = defaultdict(list)
    for joint in robot.xml.findall("joint"):
        on[_link_of(joint, "parent")].append(joint)
    children = {_link_of(joint, "child") for joints in on.values() for joint in joints}
    link = next((name for name in links if name not in children), None)
    above: list[Any] = []
    while link in links and len(on[link]) == 1:
        if any(links[link].find(tag) is not None for tag in ("visual", "collision")):
            break
        (joint,) = on.pop(link)
        above += [links[link], joint]
        if joint.get("type") in _BASE_JOINTS:
            while above:
                robot.xml.remove(above.pop())
        elif joint.get("type") != "fixed":
            break
        link = _link_of(joint, "child")
    return robot


def _link_of(joint: Any, tag: str) -> Any:
    link = joint.find(tag)
    return None if link is None else link.get("link")


def urdf_of(robot: Element) -> Urdf:
    """Return the links and joints of an element <robot>.

    Raises:
        KinfeasError: If they are no tree of supported joints, or a number is missing, not finite or
            out of its range.
    """
    links = {name: _link(name, element) for name, element in _named(robot, "link")}
    joints = {name: _joint(name, element) for name, element in _named(robot, "joint")}
    urdf = Urdf(robot.text("name"), links, joints, _find_root(links, joints.values(), robot))
    if lost := set(links).difference(descendants(urdf.on, urdf.root)):
        raise robot.error(f"link {min(lost)!r} is on a closed loop of joints")
    _check_mimics(joints, robot)
    return urdf


def _named(robot: Element, tag: str) -> Iterable[tuple[str, Element]]:
    names = set()
    for element in robot.children(tag):
        name = element.text("name")
        if name in names:
            raise robot.error(f"{tag} {name!r}: there are two {tag}s of this name")
        names.add(name)
        yield name, Element(element.xml, f"{robot.where}: {tag} {name!r}")


def _find_root(links: Mapping[str, Link], joints: Iterable[Joint], robot: Element) -> str:
    children = set()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise robot.error(f"joint {joint.name!r}: there is no link {link!r}")
        if joint.child in children:
            raise robot.error(f"joint {joint.name!r}: link {joint.child!r} has another parent, too")
        children.add(joint.child)
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise robot.error(f"must have one root link, not {', '.join(roots) or 'none'}")
    return roots[0]


def _check_mimics(joints: Mapping[str, Joint], robot: Element) -> None:
    for name, joint in joints.items():
        where, leaders, mimic = f"joint {name!r}, <mimic>", {name}, joint.mimic
        while mimic is not None:
            if mimic.joint not in joints or not joints[mimic.joint].moves:
                raise robot.error(f"{where}: there is no moving joint {mimic.joint!r}")
            if mimic.joint in leaders:
                raise robot.error(f"{where}: the joint follows itself")
            leaders.add(mimic.joint)
            mimic = joints[mimic.joint].mimic


def _link(name: str, element: Element) -> Link:
    # Physics engines read visual shapes from the same file: they are checked here.
    for visual in element.children("visual"):
        read_shapes(visual)
    shapes = [read_shapes(collision) for collision in element.children("collision")]
    mass, centre = 0.0, np.zeros(3)
    if (inertial := element.child("inertial")) is not None:
        read_moments(inertial.need("inertia"))
        mass = inertial.need("mass").number("value", limit=_MAX_MASS, minimum=0.0)
        centre = inertial.origin()[:3]
    return Link(name, mass, tuple(chain(*shapes)), not all(shapes), centre)


def read_moments(inertia: Element) -> Array:
    """Return the matrix of an <inertia>, shape (3, 3), kg m^2."""
    moments = np.zeros((3, 3))
    for name, (row, column) in MOMENTS.items():
        default, minimum = (None, 0.0) if row == column else (0.0, -math.inf)
        value = inertia.number(name, default, _MAX_MOMENT, minimum)
        moments[row, column] = moments[column, row] = value
    return moments


def read_shapes(element: Element) -> tuple[Shape, ...]:
    """Return the primitives of a <visual> or <collision>; none for a mesh.

    A capsule is a cylinder and two spheres.
    """
    pose, geometry = element.origin(), element.need("geometry")
    if box := geometry.child("box"):
        return (Shape("box", box.positive("size", 3), pose),)
    if cylinder := geometry.child("cylinder") or geometry.child("capsule"):
        (radius,), (length,) = cylinder.positive("radius"), cylinder.positive("length")
        shapes = [Shape("cylinder", (radius, length), pose)]
        if cylinder.xml.tag == "capsule":
            for z in (-length / 2.0, length / 2.0):
                end = compose(pose, make_pose(np.array([0.0, 0.0, z]), Rotation.identity()))
                shapes.append(Shape("sphere", (radius,), end))
        return tuple(shapes)
    if sphere := geometry.child("sphere"):
        return (Shape("sphere", sphere.positive("radius"), pose),)
    if mesh := geometry.child("mesh"):
        mesh.text("filename")
        mesh.vector("scale", 3, (1.0, 1.0, 1.0))
        return ()
    raise geometry.error("must hold a <box>, <cylinder>, <sphere>, <capsule> or <mesh>")


def _joint(name: str, element: Element) -> Joint:
    kind = element.text("type")
    if kind in _BASE_JOINTS:
        raise element.error(f"type {kind!r} is supported only below a root link without shapes")
    if kind not in get_args(JointKind):
        raise element.error(f"type must be one of {', '.join(get_args(JointKind))}, not {kind!r}")
    fixed = kind == "fixed"
    lower, upper = (0.0, 0.0) if fixed else _limits(element, kind)
    soft_lower, soft_upper = _soft_limits(element, kind, lower, upper)
    limit, dynamics, mimic = map(element.child, ("limit", "dynamics", "mimic"))
    velocity, effort, damping, friction = math.inf, math.inf, 0.0, 0.0
    if limit is not None:
        velocity = limit.number("velocity", 0.0, minimum=0.0)
        effort = limit.number("effort", LARGEST, minimum=0.0)
        effort = math.inf if effort == LARGEST else effort
    if dynamics is not None:
        damping = dynamics.number("damping", 0.0, minimum=0.0)
        friction = dynamics.number("friction", 0.0, minimum=0.0)
    return Joint(
        name=name, kind=cast("JointKind", kind),
        parent=element.need("parent").text("link"), child=element.need("child").text("link"),
        origin=element.origin(),
        axis=(1.0, 0.0, 0.0) if fixed else _axis(element),  # exporters write 0 0 0 for fixed joints
        lower=lower, upper=upper, soft_lower=soft_lower, soft_upper=soft_upper,
        velocity=0.0 if fixed else velocity, effort=0.0 if fixed else effort,
        damping=damping, friction=friction,
        mimic=None if fixed or mimic is None else Mimic(
            multiplier=mimic.number("multiplier", 1.0, FARTHEST),
            offset=mimic.number("offset", 0.0, FARTHEST), joint=mimic.text("joint"),
        ),
    )  # fmt: skip


def _limits(joint: Element, kind: str) -> tuple[float, float]:
    if kind == "continuous":
        return -math.inf, math.inf
    limit = joint.need("limit")
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower > upper:
        raise limit.error(f"'lower' is {lower:g}, above 'upper', which is {upper:g}")
    return lower, upper


def _soft_limits(joint: Element, kind: str, lower: float, upper: float) -> tuple[float, float]:
    safety = joint.child("safety_controller")
    if safety is None or kind in ("fixed", "continuous"):
        return lower, upper
    soft = safety.number("soft_lower_limit", lower), safety.number("soft_upper_limit", upper)
    low, high = max(soft[0], lower), min(soft[1], upper)  # the tighter of both, as in ROS
    if low > high:
        raise safety.error(
            f"soft limits {soft[0]:g} to {soft[1]:g} leave nothing of {lower:g} to {upper:g}"
        )
    return low, high


def _axis(joint: Element) -> tuple[float, float, float]:
    element, default = joint.child("axis"), (1.0, 0.0, 0.0)
    if element is None:
        return default
    axis = np.array(element.vector("xyz", 3, default))
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise joint.error("the axis must not be zero")
    x, y, z = (axis / length).tolist()
    return x, y, z
