"""The robot as physics engines load it: one URDF with planar joints and merged links."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, compose, rotation
from kinfeas.robots.elements import Element, find_mesh, numbers_text, set_origin
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint, Urdf
from kinfeas.robots.urdf_file import MOMENTS, SLACK, read_moments, read_robot_xml

PLANAR_JOINTS = ("planar_x_joint", "planar_y_joint", "planar_yaw_joint")
"""Joints of the base: along the world's x and y, then about z."""

_MESH_FORMATS = (".stl", ".obj", ".dae")
_WORLD, _CARRIERS = "planar_world_link", ("planar_x_link", "planar_y_link")
_AXES = ("1 0 0", "0 1 0", "0 0 1")
_SMALLEST = 0.01  # m, radius of gyration of links with zero moments


@dataclass(frozen=True)
class Follower:
    """A mimicking joint: position = multiplier * position of leader + offset."""

    name: str
    leader: str
    multiplier: float
    offset: float


def moving_joints(robot: Robot) -> frozenset[str]:
    """Return the names of the moving joints; all others are fixed at `fixed_joints`."""
    fingers = robot.gripper.fingers if robot.gripper else ()
    followers = (*arm_followers(robot), *finger_followers(robot))
    names = (joint.name for joint in robot.arm)
    return frozenset((*names, *fingers, *(follower.name for follower in followers)))


def arm_followers(robot: Robot) -> tuple[Follower, ...]:
    """Return the joints that mimic arm joints, such as the torso of the HSR."""
    arm = [joint.name for joint in robot.arm]
    return tuple(
        Follower(joint.name, leader.name, multiplier, offset)
        for joint in _mimics(robot.urdf)
        if joint.name not in robot.fixed_joints
        for leader, multiplier, offset in [robot.urdf.followed(joint)]
        if leader.name in arm
    )


def finger_followers(robot: Robot) -> tuple[Follower, ...]:
    """Return the joints of the fingers that mimic the joint that carries their finger.

    In a URDF all may mimic one joint; here each finger has its own motor.
    """
    followers = []
    for finger in robot.gripper.fingers if robot.gripper else ():
        links = robot.urdf.below(finger)
        motor, scale, shift = robot.urdf.followed(robot.urdf.joints[finger])
        for joint in _mimics(robot.urdf):
            leader, multiplier, offset = robot.urdf.followed(joint)
            if leader is motor and joint.parent in links:
                ratio = multiplier / scale
                followers.append(Follower(joint.name, finger, ratio, offset - ratio * shift))
    return tuple(followers)


def _mimics(urdf: Urdf) -> Iterator[Joint]:
    return (joint for joint in urdf.joints.values() if joint.moves and joint.mimic is not None)


def physics_urdf(robot: Robot) -> tuple[str, dict[str, str]]:
    """Return the URDF for the engines and, by name of each link, the link that it is merged into.

    The root gets three planar joints. Joints that do not move are fixed, and links on fixed joints
    are merged, except the EE frame: fewer links make a faster physics step. Mimic elements, which
    PyBullet does not support, are removed. Mesh paths are absolute.
    """
    xml = read_robot_xml(robot.urdf_path).xml
    for link in xml.findall("link"):
        where = f"{robot.urdf_path}: link {link.get('name')!r}, <mesh>"
        for mesh in link.iterfind("*/geometry/mesh"):
            folder = robot.urdf_path.absolute().parent
            mesh.set("filename", str(find_mesh(Element(mesh, where), folder, _MESH_FORMATS)))
    moving = moving_joints(robot)
    for element in xml.findall("joint"):
        name = element.get("name")
        for mimic in element.findall("mimic"):
            element.remove(mimic)
        joint = robot.urdf.joints[name]
        if joint.moves and name not in moving:
            element.set("type", "fixed")
            set_origin(element, joint.pose_at(robot.fixed_joints[name]))
        elif joint.moves and (axis := element.find("axis")) is not None:
            axis.set("xyz", " ".join(map(str, joint.axis)))  # of unit length, or PyBullet warns
    part_of = merge_fixed_links(xml, keep={robot.ee_frame})
    repair_inertias(xml, str(robot.urdf_path))
    for element in reversed(_planar_base(robot.urdf.root)):
        xml.insert(0, element)
    return ElementTree.tostring(xml, encoding="unicode"), part_of


def _planar_base(root: str) -> list[ElementTree.Element]:
    """Return the links and joints on which the link `root` moves over the floor."""
    elements = [ElementTree.Element("link", name=name) for name in (_WORLD, *_CARRIERS)]
    for link in elements:
        write_inertia(link, FRAME)
    parents, children = (_WORLD, *_CARRIERS), (*_CARRIERS, root)
    for name, axis, parent, child in zip(PLANAR_JOINTS, _AXES, parents, children, strict=True):
        joint = ElementTree.Element("joint", name=name)
        joint.set("type", "continuous" if name == PLANAR_JOINTS[-1] else "prismatic")
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=child)
        ElementTree.SubElement(joint, "axis", xyz=axis)
        # To PyBullet, an upper limit below the lower one means no limits.
        ElementTree.SubElement(joint, "limit", lower="0", upper="-1", effort="0", velocity="0")
        elements.append(joint)
    return elements


def merge_fixed_links(robot: Any, keep: Collection[str]) -> dict[str, str]:
    """Merge links on fixed joints, except `keep`; return what each link is merged into."""
    links = {link.get("name"): link for link in robot.findall("link")}
    part_of = {name: name for name in links}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        if joint.get("type") != "fixed" or child in keep:
            continue
        pose = Element(joint, "").origin()
        _merge(links[parent], links[child], pose)
        for other in robot.findall("joint"):
            if other.find("parent").get("link") == child:
                other.find("parent").set("link", parent)
                set_origin(other, compose(pose, Element(other, "").origin()))
        robot.remove(joint)
        robot.remove(links[child])
        part_of = {name: parent if of == child else of for name, of in part_of.items()}
    return part_of


def _merge(link: Any, part: Any, pose: Array) -> None:
    """Add shapes and inertia of `part` to a link; `pose` is that of `part` in the link's frame."""
    for tag in ("visual", "collision"):
        for element in part.findall(tag):
            set_origin(element, compose(pose, Element(element, "").origin()))
            link.append(element)
    own, added = read_inertia(link), read_inertia(part)
    if added is None:
        return
    matrix = rotation(pose).as_matrix()
    centre, moments = pose[:3] + matrix @ added.centre, matrix @ added.moments @ matrix.T
    moved = Inertia(added.mass, centre, moments)
    write_inertia(link, moved if own is None else own.plus(moved))


@dataclass(frozen=True, eq=False)
class Inertia:
    """Inertia of a link."""

    mass: float  # kg
    centre: Array  # of mass, in the link's frame, shape (3,), metres
    moments: Array  # about the centre along the link's axes, shape (3, 3), kg m^2

    def about(self, point: Array) -> Array:
        """Return the moments about a point (3,), by the parallel axis theorem, shape (3, 3)."""
        arm = self.centre - point
        return self.moments + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))

    def plus(self, other: "Inertia") -> "Inertia":
        """Return the inertia of two rigidly connected bodies."""
        mass = self.mass + other.mass
        if mass == 0.0:
            return self
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        moments = sum(part.about(centre) for part in (self, other))
        return Inertia(mass, centre, np.asarray(moments))


FRAME = Inertia(0.001, np.zeros(3), 1e-6 * np.eye(3))
"""Inertia of links without shape; PyBullet's default is 1 kg and 1 kg m^2."""


def read_inertia(link: Any) -> Inertia | None:
    """Return the inertia in an element <link> of a URDF; None without an inertia."""
    inertial = Element(link, "").child("inertial")
    if inertial is None:
        return None
    pose, moments = inertial.origin(), read_moments(inertial.need("inertia"))
    matrix = rotation(pose).as_matrix()
    return Inertia(inertial.need("mass").number("value"), pose[:3], matrix @ moments @ matrix.T)


def write_inertia(link: Any, inertia: Inertia) -> None:
    """Replace the inertia in an element <link>."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers_text(inertia.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(inertia.mass))
    moments = {name: repr(float(inertia.moments[at])) for name, at in MOMENTS.items()}
    ElementTree.SubElement(inertial, "inertia", moments)


def physical(inertia: Inertia) -> Inertia:
    """Return an inertia that satisfies the triangle inequality of principal moments.

    Vendors' files violate it. PyBullet then ignores the inertia, and the link flies off at the
    first contact. The missing moment is added about all axes.
    """
    small, middle, large = np.linalg.eigvalsh(inertia.moments)
    excess = large - small - middle
    if excess <= SLACK * large and small > 0.0:
        return inertia
    least = inertia.mass * _SMALLEST**2 - small if small <= 0.0 else 0.0
    added = max(excess, least) * (1.0 + SLACK)
    return replace(inertia, moments=inertia.moments + added * np.eye(3))


def repair_inertias(robot: Any, where: str) -> None:
    """Make the inertia of every link of the element <robot> physical.

    Links without inertia get `FRAME` if they have no shape or are on a fixed joint. Links of mass 0
    do not change.
    """
    fixed = (joint for joint in robot.findall("joint") if joint.get("type") == "fixed")
    on_fixed = {joint.find("child").get("link") for joint in fixed}
    without = []
    for link in robot.findall("link"):
        inertia = read_inertia(link)
        repaired = FRAME if inertia is None else inertia
        shaped = any(link.find(tag) is not None for tag in ("visual", "collision"))
        if inertia is None and shaped and link.get("name") not in on_fixed:
            without.append(repr(link.get("name")))
        if repaired.mass > 0.0:
            repaired = physical(repaired)
        if repaired is not inertia:
            write_inertia(link, repaired)
    if without:
        raise KinfeasError(
            f"{where}: link {', '.join(without)} has no <inertial>, which the root and links that "
            "move need with physics"
        )
