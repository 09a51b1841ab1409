"""URDFs of primitives: links and joints of a vendor's URDF with its meshes replaced."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.extras import require
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.importer.arm import Arm, axis_in_root, place
from kinfeas.robots.elements import Element, find_mesh, numbers_text, set_origin
from kinfeas.robots.urdf import Joint, Shape, ShapeKind, Urdf
from kinfeas.robots.urdf_file import read_moments, read_shapes, urdf_of

Part = Shape | Array
"""A primitive, or the triangles of a mesh, shape (t, 3, 3), metres."""

FORMATS = (".stl", ".obj", ".dae", ".ply", ".glb", ".off")
MAX_MESH_BYTES = 200_000_000

MAX_SHAPES = 32
"""Shapes of a link; more are replaced by primitives around all of them."""

HEAVY = 1.0  # kg, from which a link without shapes is no bare frame

_DIGITS = 4  # decimals of lengths and angles
_THINNEST = 10.0**-_DIGITS  # m
MARGIN = 5e-4  # m, by which primitives are too large on each side; more than rounding takes away

_CORNERS = 256  # most hull points that orient a primitive; all points determine its size
_FLAT = 1e-3  # m, thickness that flat meshes get
_CUTS = 2  # halvings at most, for four primitives
_WORTH = 0.7  # of the volume; halves that are larger together do not replace the whole
_TURNS = [
    make_pose(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True))
    for axis, angle in (("x", 0.0), ("x", 90.0), ("y", 90.0))
]
"""Poses whose z axis is each of the three axes."""

_COLOURS = ("0.78 0.8 0.83 1", "0.45 0.6 0.77 1")  # of links at even and odd depth
_SLANT = 1e-3  # cosine of an angle that still counts as a right one
_PLAY = 0.02  # m, by which wheels may be below the floor, since primitives are too large


def boxed_urdf(
    robot: Element,
    folder: Path,
    base: str | None = None,
    on_link: Callable[[str], None] | None = None,
    fitted: Collection[str] | None = None,
    originals: dict[str, list[Part]] | None = None,
) -> Element:
    """Return the element <robot> of a URDF without meshes, with equal visual and collision shapes.

    Links, joints and inertias stay. Each collision mesh becomes one to four primitives that enclose
    it. Rigid groups of links without collision shapes use their visual ones.

    Args:
        robot: The robot's element <robot>; its joints and inertias become part of the result.
        folder: Absolute path of its file's folder, to which addresses of meshes are relative.
        base: Link that becomes the root, with all that it carries; by default the root, or the link
            behind joints that move bare frames on the floor, as simulators add.
        on_link: Called with the name of each link that is done.
        fitted: Links that get shapes; all by default.
        originals: Receives the parts of links that primitives replace, in the links' frames.
    """
    urdf = urdf_of(robot)
    links = {link.text("name"): link for link in robot.children("link")}
    root = _first_body(urdf, links) if base is None else base
    if root not in urdf.links:
        raise robot.error(f"there is no link {root!r}{no_such(root, urdf.links)}")
    kept = {root}.union(*(urdf.below(joint.name) for joint in urdf.on[root]))
    colliding = {name for name, link in links.items() if link.child("collision")}
    out = ElementTree.Element("robot", name=urdf.name)
    for name in filter(kept.__contains__, links):
        link = Element(links[name].xml, f"{robot.where}: link {name!r}")
        kind = "collision" if urdf.rigid[name] & colliding else "visual"
        parts = []
        if fitted is None or name in fitted:
            parts = list(_parts(link, kind, folder))
        shapes = [shape for _, primitives in parts for shape in primitives]
        if originals is not None and (
            len(shapes) > MAX_SHAPES or not all(isinstance(part, Shape) for part, _ in parts)
        ):
            originals[name] = [part for part, _ in parts]
        if len(shapes) > MAX_SHAPES:
            require("trimesh")
            boxes = np.concatenate([_box_triangles(shape) for shape in shapes])
            shapes = list(fit_primitives(boxes))
        depth = sum(joint.moves for joint in urdf.path_to(name))
        out.append(_link(name, link.xml.find("inertial"), shapes, _COLOURS[depth % 2]))
        if on_link is not None:
            on_link(name)
    for joint in robot.children("joint"):
        if urdf.joints[joint.text("name")].parent in kept:
            out.append(joint.xml)
    return Element(out, robot.where)


def urdf_text(robot: Element) -> str:
    """Return the indented text of a URDF."""
    ElementTree.indent(robot.xml)
    return ElementTree.tostring(robot.xml, encoding="unicode", xml_declaration=True) + "\n"


def _first_body(urdf: Urdf, links: Mapping[str, Element]) -> str:
    """Return the root, or the link behind joints that move bare frames on the floor."""
    link, slides = urdf.root, False
    while True:
        group = urdf.rigid[link]
        bare = not any(links[name].child(tag) for name in group for tag in ("collision", "visual"))
        moving = [joint for name in group for joint in urdf.on[name] if joint.moves]
        if not bare or len(moving) != 1 or not _is_planar(urdf, moving[0]):
            return link if slides else urdf.root
        link, slides = moving[0].child, slides or moving[0].kind == "prismatic"


def _is_planar(urdf: Urdf, joint: Joint) -> bool:
    """Return whether a joint slides along the floor or turns about the vertical."""
    upright = abs(float(axis_in_root(urdf, joint)[2]))
    return upright < _SLANT if joint.kind == "prismatic" else upright > 1.0 - _SLANT


def _parts(link: Element, tag: str, folder: Path) -> Iterable[tuple[Part, list[Shape]]]:
    """Yield each part of a link and the primitives that replace it."""
    for element in link.children(tag):
        if own := read_shapes(element):
            for shape in own:
                yield shape, [shape]
            continue
        pose = element.origin()
        triangles = read_triangles(element.need("geometry").need("mesh"), folder)
        fitted = [replace(s, pose=compose(pose, s.pose)) for s in fit_primitives(triangles)]
        corners = rotation(pose).apply(triangles.reshape(-1, 3)) + pose[:3]
        yield corners.reshape(-1, 3, 3), fitted


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


def box_masses(robot: Element, arm: Arm) -> list[str]:
    """Give links without shapes a box in the element <robot>, and return these links.

    A heavy link gets the box of its inertia if its rigid group has no shape and the arm does not
    carry it.
    """
    urdf, boxed = urdf_of(robot), list[str]()
    bare = urdf.links.keys() - urdf.below(arm.joints[0].name)
    for link in robot.children("link"):
        name, mass = link.text("name"), urdf.links[link.text("name")].mass
        if name not in bare or mass < HEAVY or any(urdf.links[n].shapes for n in urdf.rigid[name]):
            continue
        inertial = link.need("inertial")
        moments = np.diag(read_moments(inertial.need("inertia")))
        squares = 6.0 / mass * (moments.sum() - 2.0 * moments)
        if squares.min() > 0.0:
            box = Shape("box", tuple(np.sqrt(squares).tolist()), inertial.origin())
            link.xml[:] = _link(name, inertial.xml, [box], _COLOURS[0])
            boxed.append(name)
    return boxed


def on_the_floor(robot: Element, arm: Arm) -> float:
    """Add a root link on the floor, and return the height of the old root above it, metres.

    The lowest shape that the arm does not carry is on the floor. If it is not below the root, the
    root is on the floor already, since wheels need not have shapes: nothing is added then.
    """
    urdf = urdf_of(robot)
    links = set(urdf.links) - urdf.below(arm.joints[0].name)
    shapes, down = place(urdf, sorted(links), urdf.root, urdf.link_poses({})), [0.0, 0.0, -1.0]
    depth = max((shape.reach(np.array(down)) for shape in shapes), default=0.0)
    if depth <= _PLAY:
        return 0.0
    height = round(depth, 3)
    names = ("base_footprint", "footprint", *(f"footprint_{i}" for i in range(2, 3 + len(links))))
    name = next(n for n in names if n not in urdf.links and f"{n}_joint" not in urdf.joints)
    joint = ElementTree.Element("joint", name=f"{name}_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=name)
    ElementTree.SubElement(joint, "child", link=urdf.root)
    ElementTree.SubElement(joint, "origin", xyz=f"0 0 {height:g}", rpy="0 0 0")
    robot.xml.insert(0, joint)
    robot.xml.insert(0, ElementTree.Element("link", name=name))
    return height


def read_triangles(mesh: Element, folder: Path) -> Array:
    """Return the scaled triangles of an element <mesh> of a URDF in `folder`, (t, 3, 3), metres."""
    path = find_mesh(mesh, folder, FORMATS)
    if path.stat().st_size > MAX_MESH_BYTES:
        raise mesh.error(f"{str(path)!r} is larger than {MAX_MESH_BYTES} bytes")
    require("trimesh", *(["collada"] if path.suffix.lower() == ".dae" else []))
    scale = mesh.vector("scale", 3, (1.0, 1.0, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        triangles = _load(path, mesh.where) * np.array(scale)
    if not len(triangles) or not (np.abs(triangles) <= FARTHEST).all():
        raise mesh.error(f"{str(path)!r} has no triangles, or corners not within {FARTHEST:g} m")
    return triangles


def _load(path: Path, where: str) -> Array:
    import trimesh

    try:
        scene = trimesh.load_scene(path, skip_materials=True)
        metres = trimesh.units.unit_conversion(scene.units or "meters", "meters")
        # Not `to_mesh`, which copies textures and needs Pillow.
        return np.asarray(scene.triangles, dtype=np.float64).reshape(-1, 3, 3) * metres
    except Exception as error:
        raise KinfeasError(
            f"{where}: {str(path)!r} cannot be read as a mesh: {type(error).__name__}: {error}"
        ) from error


def fit_primitives(triangles: Array) -> tuple[Shape, ...]:
    """Return one to four primitives that together enclose triangles, shape (t, 3, 3), metres.

    The mesh is halved where primitives around the halves are much smaller.
    """
    return tuple(_cut(triangles, _smallest(triangles.reshape(-1, 3)), _CUTS))


def volume(shape: Shape) -> float:
    """Return the volume of a primitive, cubic metres."""
    if shape.kind == "box":
        return float(np.prod(shape.size))
    if shape.kind == "cylinder":
        return float(np.pi * shape.size[0] ** 2 * shape.size[1])
    return float(4.0 / 3.0 * np.pi * shape.size[0] ** 3)


def _box_triangles(shape: Shape) -> Array:
    """Return the triangles of the box around a shape along its axes, (12, 3, 3)."""
    rotation_of_box, middle = rotation(shape.pose), shape.pose[:3]
    extents = [shape.reach(axis) - middle @ axis for axis in rotation_of_box.as_matrix().T]
    unit = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return (rotation_of_box.apply(unit * extents) + middle)[ConvexHull(unit).simplices]


def _cut(triangles: Array, whole: Shape, cuts: int) -> list[Shape]:
    """Return primitives for a mesh that `whole` encloses, after at most `cuts` halvings."""
    if cuts == 0:
        return [whole]
    halves = [
        [(half, _smallest(half.reshape(-1, 3))) for half in choice]
        for choice in (_halves(triangles, whole, axis) for axis in range(3))
        if all(map(len, choice))
    ]
    best = min(halves, key=lambda parts: sum(volume(shape) for _, shape in parts), default=[])
    if not best or sum(volume(shape) for _, shape in best) > _WORTH * volume(whole):
        return [whole]
    return [primitive for half, shape in best for primitive in _cut(half, shape, cuts - 1)]


def _halves(triangles: Array, whole: Shape, axis: int) -> list[Array]:
    """Return the mesh on either side of its middle plane across an axis of `whole`."""
    from trimesh.intersections import slice_faces_plane

    normal = rotation(whole.pose).as_matrix()[:, axis]
    along = triangles @ normal
    origin = (along.min() + along.max()) / 2.0 * normal
    corners, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    sides = []
    for sign in (1.0, -1.0):
        points, kept, *_ = slice_faces_plane(corners, faces, sign * normal, origin)
        sides.append(points[kept])
    return sides


def _smallest(points: Array) -> Shape:
    """Return the smallest box, cylinder or sphere around `points`, shape (n, 3)."""
    from trimesh.bounds import oriented_bounds

    corners = _hull(points)
    to_box, _ = oriented_bounds(corners[:: len(corners) // _CORNERS + 1])
    matrix = np.linalg.inv(to_box)
    box = make_pose(matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]))
    cylinders = [_around(corners, "cylinder", compose(box, axes)) for axes in _TURNS]
    return min(
        _around(corners, "box", box), _around(corners, "sphere", box), *cylinders, key=volume
    )


def _around(corners: Array, kind: ShapeKind, pose: Array) -> Shape:
    """Return the primitive at `pose` that encloses `corners`, with the margin."""
    inner = np.abs(rotation(pose).inv().apply(corners - pose[:3]))
    x, y, z = (inner.max(axis=0) + MARGIN).tolist()
    size: tuple[float, ...] = (2.0 * x, 2.0 * y, 2.0 * z)
    if kind == "cylinder":
        size = (float(np.hypot(inner[:, 0], inner[:, 1]).max()) + MARGIN, 2.0 * z)
    if kind == "sphere":
        size = (float(np.linalg.norm(inner, axis=1).max()) + MARGIN,)
    return Shape(kind, size, pose)


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull; flat sets of points get a thickness first."""
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)
    for axis in axes:
        along = (points - middle) @ axis
        if np.ptp(along) < _FLAT:
            points = np.concatenate([points - _FLAT / 2.0 * axis, points + _FLAT / 2.0 * axis])
    return points[ConvexHull(points).vertices]
