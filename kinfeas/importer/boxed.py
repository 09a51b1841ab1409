"""A URDF of primitives: the links and joints of another one, its meshes boxed in."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from itertools import chain, count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.importer.arm import Arm, link_pose, place
from kinfeas.robots.elements import (
    Element,
    find_mesh,
    numbers_text,
    parse_xml,
    read_xml,
    set_origin,
)
from kinfeas.robots.urdf import Joint, Shape, ShapeKind, Urdf, read_shape, urdf_of

MARGIN = 5e-4
"""Metres by which primitives are too large at each side, for they are written in few digits."""

_CORNERS = 256  # that say how a primitive lies, at most; all of them say how large it is
_THIN = 1e-3  # m, of which nothing is thinner
_TURNS = [
    make_pose(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True))
    for axis, angle in (("x", 0.0), ("x", 90.0), ("y", 90.0))
]
"""Which lay the z axis along each of the three."""

_CUTS = 2  # halvings at most, which make four primitives
_WORTH = 0.7  # of the volume that halves may have together, if they are to take the whole's place


def fit_primitives(triangles: Array) -> tuple[Shape, ...]:
    """Return one to four primitives that together hold a mesh.

    A mesh is cut across where its halves take much less room in primitives of their own.

    Args:
        triangles: Corners of the mesh, shape (t, 3, 3), metres, t at least 1.
    """
    return tuple(_cut(triangles, _smallest(triangles.reshape(-1, 3)), _CUTS))


def volume(shape: Shape) -> float:
    """Return the volume of a primitive, cubic metres."""
    if shape.kind == "box":
        return float(np.prod(shape.size))
    if shape.kind == "cylinder":
        return float(np.pi * shape.size[0] ** 2 * shape.size[1])
    return float(4.0 / 3.0 * np.pi * shape.size[0] ** 3)


def _cut(triangles: Array, whole: Shape, cuts: int) -> list[Shape]:
    """Return primitives for a mesh that `whole` holds, cut `cuts` times at most."""
    if cuts == 0:
        return [whole]
    choices = [_halves(triangles, whole, axis) for axis in range(3)]
    halves = [
        [(half, _smallest(half.reshape(-1, 3))) for half in choice]
        for choice in choices
        if all(map(len, choice))
    ]
    best = min(halves, key=lambda parts: sum(volume(shape) for _, shape in parts), default=[])
    if not best or sum(volume(shape) for _, shape in best) > _WORTH * volume(whole):
        return [whole]
    return [found for half, shape in best for found in _cut(half, shape, cuts - 1)]


def _halves(triangles: Array, whole: Shape, axis: int) -> list[Array]:
    """Return what lies on either side of the plane across the middle of the mesh."""
    from trimesh.intersections import slice_faces_plane

    normal = rotation(whole.pose).as_matrix()[:, axis]
    along = triangles @ normal
    origin = (along.min() + along.max()) / 2.0 * normal
    corners, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    sides = []
    for way in (1.0, -1.0):
        points, kept, *_ = slice_faces_plane(corners, faces, way * normal, origin)
        sides.append(points[kept])
    return sides


def _smallest(points: Array) -> Shape:
    """Return the smallest primitive around `points`, shape (n, 3): all are centred in the box."""
    corners = _hull(points)
    box = _box_pose(corners[:: len(corners) // _CORNERS + 1])
    upright = [compose(box, turn) for turn in _TURNS]
    found = [
        _around(corners, "box", box),
        _around(corners, "sphere", box),
        *(_around(corners, "cylinder", pose) for pose in upright),
    ]
    return min(found, key=volume)


def _around(corners: Array, kind: ShapeKind, pose: Array) -> Shape:
    """Return the primitive of a kind that stands at `pose` and holds `corners`, a little larger."""
    inner = np.abs(_seen_from(pose, corners))
    x, y, z = (inner.max(axis=0) + MARGIN).tolist()
    size: tuple[float, ...] = (2.0 * x, 2.0 * y, 2.0 * z)
    if kind == "cylinder":
        size = (float(np.hypot(inner[:, 0], inner[:, 1]).max()) + MARGIN, 2.0 * z)
    if kind == "sphere":
        size = (float(np.linalg.norm(inner, axis=1).max()) + MARGIN,)
    return Shape(kind, size, pose)


def _seen_from(pose: Array, points: Array) -> Array:
    """Return points, shape (n, 3), in the frame that stands at `pose`."""
    inner: Array = rotation(pose).inv().apply(points - pose[:3])
    return inner


def _box_pose(corners: Array) -> Array:
    """Return the pose of the smallest box around points, shape (7,)."""
    from trimesh.bounds import oriented_bounds

    to_box, _ = oriented_bounds(corners)
    matrix = np.linalg.inv(to_box)
    return make_pose(matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]))


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points, which are given a thickness if they lack it.

    What is flat, a line or a point has no hull otherwise.
    """
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)
    for axis in axes:
        along = (points - middle) @ axis
        if np.ptp(along) < _THIN:
            points = np.concatenate([points - _THIN / 2.0 * axis, points + _THIN / 2.0 * axis])
    return points[ConvexHull(points).vertices]


FORMATS = (".stl", ".obj", ".dae", ".ply", ".glb", ".off")

_LARGEST = 200_000_000  # bytes
_READER, _DAE_READER = "trimesh", "collada"


def read_triangles(mesh: Element, folder: Path) -> Array:
    """Return the triangles of an element <mesh>, scaled as it says, shape (t, 3, 3), metres.

    Args:
        mesh: The element.
        folder: Where the URDF lies, an absolute path.

    Raises:
        KinfeasError: If there is no such file, it cannot be read, it holds no triangle, or it
            reaches farther than `FARTHEST`.
    """
    path = find_mesh(mesh, folder, FORMATS)
    if path.stat().st_size > _LARGEST:
        raise mesh.error(f"{str(path)!r} is too large, at most {_LARGEST} bytes are allowed")
    scale = mesh.vector("scale", 3, (1.0, 1.0, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        triangles = _load(path, mesh.where) * np.array(scale)
    if not len(triangles) or not (np.abs(triangles) <= FARTHEST).all():
        raise mesh.error(
            f"{str(path)!r} holds no triangles, or corners that are not finite or not within "
            f"{FARTHEST:g} m"
        )
    return triangles


def _load(path: Path, where: str) -> Array:
    readers = [_READER, _DAE_READER] if path.suffix.lower() == ".dae" else [_READER]
    if not all(map(find_spec, readers)):
        raise KinfeasError(
            f"{where}: meshes are read by packages that are not there: "
            "pip install 'kinfeas[meshes]'"
        )
    import trimesh

    try:
        scene = trimesh.load_scene(path)
        metres = trimesh.units.unit_conversion(scene.units or "meters", "meters")
        return np.asarray(scene.to_mesh().triangles, dtype=np.float64) * metres
    except Exception as error:  # readers of meshes raise anything on broken files
        raise KinfeasError(
            f"{where}: {str(path)!r} cannot be read as a mesh: {type(error).__name__}: {error}"
        ) from error


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
