"""Reading of a vendor's URDF beyond arm and hand: mesh options, drive of the base, warnings."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from xml.etree.ElementTree import SubElement

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.importer.arm import Arm, axis_in_root
from kinfeas.importer.boxed import HEAVY
from kinfeas.importer.formats import read_robot
from kinfeas.robots.elements import LARGEST, Element
from kinfeas.robots.spec import Drive
from kinfeas.robots.urdf import Joint, Urdf
from kinfeas.robots.urdf_file import urdf_of

MOST_LINKS = 2000
"""Links of a robot at most: all pairs of them are checked for contact."""

_OMNIDIRECTIONAL = re.compile(r"mecanum|omni|swerve|holonomic", re.IGNORECASE)
_CASTER = re.compile(r"cast[eo]r", re.IGNORECASE)
_UPRIGHT, _LEVEL, _PARALLEL = 0.9, 0.2, 0.98  # cosines of angles, to the vertical or between axes
_LONGEST = 5.0  # m; longer links are more likely in other units
_LISTED = 5  # names in a message at most


def read_description(
    path: Path,
    folder: Path,
    *,
    meshes: bool = True,
    mesh_paths: Mapping[str, str] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Element:
    """Return the element <robot> of a URDF, xacro or MJCF, without its meshes unless `meshes`.

    Args:
        path: The file.
        folder: Where the meshes of an MJCF are written.
        meshes: Whether meshes are kept.
        mesh_paths: Beginnings of mesh addresses, and their replacements.
        arguments: Arguments of a xacro.
    """
    robot = read_robot(path, folder, arguments or {})
    links = robot.xml.findall("link")
    if len(links) > MOST_LINKS:
        raise KinfeasError(f"{path}: {len(links)} links; at most {MOST_LINKS} are supported")
    unused = set(mesh_paths or {})
    for link in links:
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            address = mesh.get("filename", "")
            for old, new in (mesh_paths or {}).items():
                if address.startswith(old):
                    unused.discard(old)
                    mesh.set("filename", new + address.removeprefix(old))
            if not meshes:
                link.remove(shape)
    if unused:
        raise KinfeasError(f"{path}: no address of a mesh begins with {min(unused)!r}")
    _rename_world(robot)
    _complete_limits(robot)
    _couple_telescopes(robot)
    return robot


def _rename_world(robot: Element) -> None:
    """Rename a link `world`: in MuJoCo that is the floor."""
    names, name = {link.get("name") for link in robot.xml.iterfind("link")}, "world_link"
    while name in names:
        name += "_"
    for tag, key in (("link", "name"), ("joint/parent", "link"), ("joint/child", "link")):
        for element in robot.xml.iterfind(f"{tag}[@{key}='world']"):
            element.set(key, name)


def _complete_limits(robot: Element) -> None:
    """Write limits of effort and velocity where there are none, since other programs need them.

    Exporters write an effort of 0 for none.
    """
    for limit in robot.xml.iterfind("joint/limit"):
        with suppress(ValueError):  # an error of the URDF, later
            if float(limit.get("effort", "0")) == 0.0:
                limit.set("effort", f"{LARGEST:g}")
        limit.attrib.setdefault("velocity", f"{LARGEST:g}")


def _couple_telescopes(robot: Element) -> None:
    """Make prismatic joints that extend a parallel one with equal limits mimic the first of these.

    Vendors describe the segments of a telescope as joints; one motor moves all of them.
    """
    urdf = urdf_of(robot)
    leaders: dict[str, str] = {}
    for element in robot.xml.findall("joint"):
        joint = urdf.joints[element.get("name")]
        above = next((j for j in reversed(urdf.path_to(joint.parent)) if j.moves), None)
        if joint.kind != "prismatic" or joint.mimic or above is None or above.kind != joint.kind:
            continue
        alike = (joint.lower, joint.upper) == (above.lower, above.upper)
        if alike and axis_in_root(urdf, joint) @ axis_in_root(urdf, above) > _PARALLEL:
            leaders[joint.name] = leaders.get(above.name, above.name)
            SubElement(element, "mimic", joint=leaders[joint.name])


def _telescopes(urdf: Urdf) -> dict[str, list[str]]:
    """Return prismatic joints that mimic one nearer to the root, by the name of that leader."""
    segments: dict[str, list[str]] = {}
    for joint in urdf.joints.values():
        leader = urdf.followed(joint)[0]
        if joint.mimic and joint.kind == "prismatic" and leader in urdf.path_to(joint.parent):
            segments.setdefault(leader.name, []).append(joint.name)
    return segments


def find_drive(urdf: Urdf, arm: Arm, whole: Urdf) -> tuple[Drive, str]:
    """Return the drive of a base, and the reason as text.

    Names and axes of the wheels decide. If they leave only a guess, horizontal prismatic joints
    below the base in the `whole` description decide: two or more make the base omnidirectional.
    """
    drive, why = _wheel_drive(urdf, arm)
    below = [joint for joint in whole.path_to(arm.hand) if joint.name not in urdf.joints]
    slides = [
        j.name for j in below if j.kind == "prismatic" and abs(axis_in_root(whole, j)[2]) < _LEVEL
    ]
    if not slides or not why.startswith("a guess"):
        return drive, why
    drive = "omnidirectional" if len(slides) > 1 else "differential"
    return drive, f"planar joints below the base: {_listed(slides)}"


def _wheel_drive(urdf: Urdf, arm: Arm) -> tuple[Drive, str]:
    base = set(urdf.links) - urdf.below(arm.joints[0].name)
    joints = [joint for joint in urdf.joints.values() if joint.child in base]
    names = [*sorted(base), *(joint.name for joint in joints)]
    if named := [name for name in names if _OMNIDIRECTIONAL.search(name)]:
        return "omnidirectional", f"the name {named[0]}"
    axes = {joint.name: axis_in_root(urdf, joint) for joint in joints if joint.moves}
    wheels = [j for j in joints if j.kind == "continuous" and abs(axes[j.name][2]) < _LEVEL]
    if driven := [wheel for wheel in wheels if not _CASTER.search(wheel.name + wheel.child)]:
        wheels = driven  # casters are passive
    steering = {wheel.name: _steering(urdf, wheel, axes) for wheel in wheels}
    fixed = [wheel for wheel in wheels if steering[wheel.name] is None]
    listed = _listed(wheel.name for wheel in wheels)
    if not wheels:
        return "differential", "a guess: no wheel has a joint"
    if not fixed:
        return "omnidirectional", f"wheels steered by {_listed(filter(None, steering.values()))}"
    parallel = [abs(axes[fixed[0].name] @ axes[wheel.name]) > _PARALLEL for wheel in fixed]
    if not all(parallel):
        return "omnidirectional", f"wheels in several directions: {listed}"
    if len(wheels) == 2:
        return "differential", f"two driven wheels: {listed}"
    return "differential", f"a guess: {len(wheels)} wheels, perhaps mecanum or steered: {listed}"


def _steering(urdf: Urdf, wheel: Joint, axes: Mapping[str, Array]) -> str | None:
    """Return the upright joint that turns a wheel, None without one."""
    above = (j.name for j in urdf.path_to(wheel.parent) if j.kind in ("revolute", "continuous"))
    return next((name for name in above if abs(axes[name][2]) > _UPRIGHT), None)


def doubts(urdf: Urdf, guessed: Iterable[str] = ()) -> tuple[str, ...]:
    """Return warnings about a URDF: shapes or masses that are probably wrong, and telescopes.

    The shapes of the `guessed` links are boxes of their inertia.
    """
    warnings = []
    if guessed:
        warnings.append(
            f"{_listed(guessed)} without shapes: boxes of the same inertia stand for them"
        )
    bare = [
        name
        for name, link in urdf.links.items()
        if (link.mass >= HEAVY or name == urdf.root)
        and not any(urdf.links[other].shapes for other in urdf.rigid[name])
    ]
    if bare:
        warnings.append(f"{_listed(bare)} without shapes: their collisions are not found")
    for leader, segments in _telescopes(urdf).items():
        warnings.append(f"{_listed(segments)} follow {leader}, as segments of a telescope")
    sizes = {
        name: max((max(shape.size) for shape in link.shapes), default=0.0)
        for name, link in urdf.links.items()
    }
    if large := [name for name, size in sizes.items() if size > _LONGEST]:
        warnings.append(
            f"{_listed(large)} up to {max(sizes.values()):.0f} m long: if meshes are in "
            'millimetres, <mesh> needs scale="0.001 0.001 0.001"'
        )
    bodies = dict.fromkeys(urdf.rigid.values())
    light = [
        next(name for name in urdf.links if name in body and urdf.links[name].shapes)
        for body in bodies
        if not any(urdf.links[name].mass for name in body)
        and any(urdf.links[name].shapes for name in body)
    ]
    if light:
        warnings.append(
            f"{_listed(light)} without mass: --world pybullet and mujoco need an <inertial>"
        )
    return tuple(warnings)


def _listed(names: Iterable[str]) -> str:
    unique = list(dict.fromkeys(names))
    more = f" and {len(unique) - _LISTED} more" if len(unique) > _LISTED else ""
    return ", ".join(unique[:_LISTED]) + more
