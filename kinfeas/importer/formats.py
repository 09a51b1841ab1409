"""Vendors' descriptions as the element <robot> of a URDF: URDF, xacro and MJCF."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.extras import require
from kinfeas.core.spatial import Array, compose, make_pose, planar_pose, relative, yaw
from kinfeas.robots.elements import (
    LARGEST,
    Element,
    numbers_text,
    packages,
    parse_xml,
    read_xml,
    set_origin,
)
from kinfeas.robots.urdf_file import MOMENTS, without_base_joints

# Numbers of MuJoCo's enumerations mjtGeom, mjtJoint and mjtEq.
_GEOMS = {2: "sphere", 3: "capsule", 4: "box", 5: "cylinder", 6: "box", 7: "mesh"}  # 4: ellipsoids
_FREE, _BALL, _SLIDE, _JOINTS = 0, 1, 2, {2: "prismatic", 3: "revolute"}
_EQUAL_JOINTS = 2
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


def read_robot(path: Path, folder: Path, arguments: Mapping[str, str]) -> Element:
    """Return the element <robot> of a URDF, xacro or MJCF.

    Args:
        path: The file; its content decides on the format.
        folder: Where the meshes of an MJCF are written.
        arguments: Arguments of a xacro.

    Raises:
        KinfeasError: If the file is invalid, or arguments are given for another format.
    """
    robot = read_xml(path, "robot", "mujoco")
    if path.suffix == ".xacro" or any("xacro}" in element.tag for element in robot.xml.iter()):
        return without_base_joints(_expanded(path, arguments))
    if arguments:
        raise KinfeasError(f"{path}: only a xacro has arguments, such as {min(arguments)!r}")
    return _from_mjcf(path, folder) if robot.xml.tag == "mujoco" else without_base_joints(robot)


class _Arguments(dict[str, str]):
    """Arguments of a xacro, and the names that it has looked up."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.known: set[str] = set()

    def __contains__(self, name: object) -> bool:  # by <xacro:arg>
        self.known.add(str(name))
        return super().__contains__(name)


def _expanded(path: Path, arguments: Mapping[str, str]) -> Element:
    """Return the element <robot> of a xacro; packages are found as those of meshes."""
    require("xacro")
    import xacro
    from xacro import substitution_args

    above = path.absolute().parent

    def find(package: str) -> str:
        for folder in packages(package, above):
            if folder.is_dir():
                return str(folder)
        raise KinfeasError(f"there is no package {package!r}")

    original, substitution_args._eval_find = substitution_args._eval_find, find
    own = _Arguments(arguments)
    try:
        document = xacro.process_file(str(path), mappings=own)
    except Exception as error:
        raise KinfeasError(f"{path}: xacro: {type(error).__name__}: {error}") from error
    finally:
        substitution_args._eval_find = original
    for name in sorted(arguments.keys() - own.known):
        raise KinfeasError(f"{path}: the xacro has no argument {name!r}{no_such(name, own.known)}")
    return parse_xml(document.toxml(), "robot", str(path))


def _from_mjcf(path: Path, folder: Path) -> Element:
    """Return an MJCF as the element <robot>; its meshes are written to `folder`.

    The world is the root link. A body with several joints, or a joint away from its origin, gets
    bare links in between. Free joints become fixed ones, above the origin. Joints that an equality
    couples become mimic joints; other constraints, such as those that close the loops of a gripper,
    are left out, and so is the scenery.
    """
    require("mujoco")
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise KinfeasError(f"{path}: {error}") from error
    meshes = _write_meshes(model, folder)
    links = [model.body(i).name or f"body_{i}" for i in range(model.nbody)]
    scenery = _scenery(model)
    robot = Element(ElementTree.Element("robot", name=path.stem), str(path))
    for body, name in enumerate(links):
        if body and body in scenery:
            continue
        link = ElementTree.SubElement(robot.xml, "link", name=name)
        if body and model.body_mass[body]:
            _add_inertial(link, model, body)
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            if body not in scenery:
                _add_shape(link, model, geom, meshes)
    for body in range(1, model.nbody):
        if body not in scenery:
            _add_joints(robot, model, body, links)
    _add_mimics(robot, model)
    return robot


def _scenery(model: Any) -> set[int]:
    """Return the bodies that are no part of the robot, with 0, the world, if its geoms are none.

    Free bodies without other joints are objects. Around a robot with a free or sliding base, bodies
    that do not move are furniture; otherwise the robot may stand on them.
    """
    tree, joint_tree = model.body_rootid, model.body_rootid[model.jnt_bodyid]
    robots = set(joint_tree[np.isin(model.jnt_type, list(_JOINTS))].tolist())
    objects = set(joint_tree[model.jnt_type == _FREE].tolist()) - robots
    first = [model.jnt_type[model.body_jntadr[i]] for i in robots if model.body_jntnum[i]]
    if robots and {_FREE, _SLIDE} & set(first):
        objects = set(tree.tolist()) - robots
    return set(np.flatnonzero(np.isin(tree, list(objects))).tolist()) if robots else set()


def _write_meshes(model: Any, folder: Path) -> list[Path]:
    """Write the meshes of a model as STL and return their files, by number."""
    if model.nmesh:
        require("trimesh")
    paths = []
    for i in range(model.nmesh):
        from trimesh import Trimesh

        vertex, face = model.mesh_vertadr[i], model.mesh_faceadr[i]
        vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[i]]
        faces = model.mesh_face[face : face + model.mesh_facenum[i]]
        paths.append(folder / f"{i}.stl")
        Trimesh(vertices, faces, process=False).export(paths[-1])
    return paths


def _add_inertial(link: Any, model: Any, body: int) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    set_origin(inertial, _pose(model.body_ipos[body], model.body_iquat[body]))
    _add(inertial, "mass", value=model.body_mass[body])
    moments = np.diag(model.body_inertia[body])
    _add(inertial, "inertia", **{name: moments[at] for name, at in MOMENTS.items()})


def _add_shape(link: Any, model: Any, geom: int, meshes: list[Path]) -> None:
    """Add a geom to a link, as collision or, without contacts, as visual; planes are left out."""
    colliding = model.geom_contype[geom] or model.geom_conaffinity[geom]
    kind, size = model.geom(geom).type.item(), model.geom_size[geom]
    shape = ElementTree.Element("geometry")
    match _GEOMS.get(kind):
        case "mesh":
            ElementTree.SubElement(shape, "mesh", filename=str(meshes[model.geom_dataid[geom]]))
        case "box":
            _add(shape, "box", size=2.0 * size)
        case "sphere":
            _add(shape, "sphere", radius=size[0])
        case "cylinder" | "capsule" as round_shape:
            _add(shape, round_shape, radius=size[0], length=2.0 * size[1])
        case None:
            return
    element = ElementTree.SubElement(link, "collision" if colliding else "visual")
    set_origin(element, _pose(model.geom_pos[geom], model.geom_quat[geom]))
    element.append(shape)


def _add_joints(robot: Element, model: Any, body: int, links: list[str]) -> None:
    """Add the joints between a body and its parent, and the links between these."""
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    joints = [i for i in range(first, first + count) if model.jnt_type[i] in _JOINTS]
    if count and model.jnt_type[first] == _BALL:
        raise robot.error(f"body {links[body]!r}: ball joints are not supported")
    origin = _pose(model.body_pos[body], model.body_quat[body])
    if count and model.jnt_type[first] == _FREE:  # only height and tilt belong to the robot
        origin = relative(origin, planar_pose(origin[0], origin[1], yaw(origin)))
    parent, anchor = links[model.body_parentid[body]], np.zeros(3)
    for i in joints:
        position = model.jnt_pos[i]
        last = i == joints[-1] and not position.any()
        child = links[body] if last else f"{links[body]}_{i - first}"
        if not last:
            ElementTree.SubElement(robot.xml, "link", name=child)
        kind = _JOINTS[model.jnt_type[i]]
        if kind == "revolute" and not model.jnt_limited[i]:
            kind = "continuous"
        joint_origin = compose(origin, _pose(position - anchor))
        joint = _add_joint(robot, _joint_name(model, i), kind, parent, child, joint_origin)
        _describe(joint, model, i)
        parent, anchor, origin = child, position, _pose(np.zeros(3))
    if parent != links[body]:
        end = compose(origin, _pose(-anchor))
        _add_joint(robot, f"{links[body]}_fixed", "fixed", parent, links[body], end)


def _add_joint(robot: Element, name: str, kind: str, parent: str, child: str, origin: Array) -> Any:
    joint = ElementTree.SubElement(robot.xml, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    set_origin(joint, origin)
    return joint


def _describe(joint: Any, model: Any, i: int) -> None:
    """Add axis, limits and friction of joint `i`; its position is 0 at the model's `qpos0`."""
    dof, limits = model.jnt_dofadr[i], np.array([-LARGEST, LARGEST])
    if model.jnt_limited[i]:
        limits = model.jnt_range[i] - model.qpos0[model.jnt_qposadr[i]]
    _add(joint, "axis", xyz=model.jnt_axis[i])
    _add(joint, "limit", lower=limits[0], upper=limits[1], **_effort(model, i))
    damping, friction = model.dof_damping[dof], model.dof_frictionloss[dof]
    _add(joint, "dynamics", damping=damping, friction=friction)


def _effort(model: Any, i: int) -> dict[str, float]:
    """Return the least effort limit of joint `i` and its actuators as an attribute, if any."""
    efforts = [model.jnt_actfrcrange[i][1]] if model.jnt_actfrclimited[i] else []
    for actuator in np.flatnonzero(model.actuator_trnid[:, 0] == i):
        if model.actuator_trntype[actuator] != 0:
            continue
        gear = abs(model.actuator_gear[actuator][0])
        if model.actuator_forcelimited[actuator]:
            efforts.append(model.actuator_forcerange[actuator][1] * gear)
        if (
            model.actuator_ctrllimited[actuator] and not model.actuator_biastype[actuator]
        ):  # a motor
            gain = model.actuator_gainprm[actuator][0]
            efforts.append(model.actuator_ctrlrange[actuator][1] * gain * gear)
    return {"effort": min(efforts)} if efforts else {}


def _add_mimics(robot: Element, model: Any) -> None:
    joints = {joint.get("name"): joint for joint in robot.xml.iter("joint")}
    for i in np.flatnonzero(model.eq_type == _EQUAL_JOINTS).tolist():
        follower, leader = model.eq_obj1id[i], model.eq_obj2id[i]
        offset, multiplier, *more = model.eq_data[i][:5]
        if leader >= 0 and model.eq_active0[i] and not any(more):
            mimic = {"multiplier": multiplier, "offset": offset}
            joint = joints[_joint_name(model, follower)]
            _add(joint, "mimic", **mimic).set("joint", _joint_name(model, leader))


def _joint_name(model: Any, i: int) -> str:
    return model.joint(i).name or f"joint_{i}"


def _pose(position: Array, wxyz: Array = _NO_TURN) -> Array:
    return make_pose(position, Rotation.from_quat(wxyz, scalar_first=True))


def _add(parent: Any, tag: str, **numbers: Any) -> Any:
    attributes = {key: numbers_text(np.atleast_1d(value)) for key, value in numbers.items()}
    return ElementTree.SubElement(parent, tag, attributes)
