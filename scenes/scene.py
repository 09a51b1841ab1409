"""Scenes: a room with objects and handles, read from YAML, and its furniture as solids."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas import config
from kinfeas.config import Settings
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import is_path, reading
from kinfeas.core.quantities import Vector
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.robots.elements import read_xml
from kinfeas.robots.urdf import Shape, Urdf
from kinfeas.robots.urdf_file import urdf_of
from kinfeas.scenes.check import check_inertia, check_layout
from kinfeas.scenes.objects import (
    Handle,
    HandleSpec,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    free_joints,
    moving_joint,
)

T = TypeVar("T")

_UPRIGHT = 1.0 - 1e-6  # smallest vertical part of the z axis of an upright shape
_FOLDER = Path(__file__).parent
SHIPPED = ("room", "shelf", "doorway")
"""Names of the scenes of the package."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A room with objects."""

    name: str  # short name
    size: tuple[float, float]  # size of the floor along x and y, metres; the origin is its centre
    objects: dict[str, SceneObject]  # objects by name
    handles: dict[str, Handle]  # handles by name

    def handle_pose(self, name: str) -> Array:
        """Return the world pose of a handle, shape (7,), x along the approach and z up."""
        handle = _of(self.handles, name, f"scene {self.name}: there is no handle")
        return compose(self.objects[handle.object].link_poses()[handle.link], handle.pose)

    def with_poses(self, poses: Mapping[str, Array]) -> "Scene":
        """Return the scene with other world poses, (7,), by object; `check_layout` checks them."""
        moved = {name: replace(self._object(name), pose=pose) for name, pose in poses.items()}
        return replace(self, objects={**self.objects, **moved})

    def with_joints(self, positions: Mapping[str, Mapping[str, float]]) -> "Scene":
        """Return the scene with other positions, rad or m, by the names of objects and joints."""
        moved = {}
        for name, joints in positions.items():
            scene_object = self._object(name)
            _check_joints(scene_object.urdf, joints, f"scene {self.name}: object {name!r}")
            moved[name] = replace(
                scene_object, joint_positions={**scene_object.joint_positions, **joints}
            )
        return replace(self, objects={**self.objects, **moved})

    def check_layout(self, source: str) -> None:
        """Raise an error that begins with `source` unless objects are on the floor and apart."""
        check_layout(source, self.size, self.objects)

    def _object(self, name: str) -> SceneObject:
        return _of(self.objects, name, f"scene {self.name}: there is no object")


def read_scene(name_or_path: str, settings: Settings | None = None) -> Scene:
    """Return the scene of a YAML file (`my/scene.yaml`) or of a shipped name (`room`).

    Args:
        name_or_path: Path or name.
        settings: Values by key such as `objects.box.position`.

    Raises:
        KinfeasError: If there is no such scene, one of its files is invalid, or objects overlap.
    """
    path = _find(name_or_path)
    spec = config.load(SceneSpec, path, settings)
    urdfs: dict[Path, Urdf] = {}
    objects = {
        name: _object(block, path, f"{path}: 'objects.{name}", urdfs)
        for name, block in spec.objects.items()
    }
    handles = {
        name: _handle(block, objects, f"{path}: 'handles.{name}")
        for name, block in spec.handles.items()
    }
    scene = Scene(spec.name, spec.size, objects, handles)
    scene.check_layout(str(path))
    return scene


def _find(name_or_path: str) -> Path:
    if is_path(name_or_path):
        return Path(name_or_path)
    if name_or_path not in SHIPPED:
        hint = no_such(name_or_path, SHIPPED)
        raise KinfeasError(f"unknown scene {name_or_path!r}{hint}, or the path of a YAML file")
    return _FOLDER / f"{name_or_path}.yaml"


def _object(spec: ObjectSpec, path: Path, where: str, urdfs: dict[Path, Urdf]) -> SceneObject:
    file = _find_urdf(spec.urdf, path.parent, f"{where}.urdf'")
    if file not in urdfs:
        urdfs[file] = urdf_of(read_xml(file, "robot"))
    urdf = urdfs[file]
    _check_primitives(urdf, file)
    check_inertia(file, urdf, fixed=spec.fixed)
    _check_joints(urdf, spec.joints, f"{where}.joints'")
    pose = _pose(spec.position, spec.rpy)
    rest = {name: joint.rest for name, joint in free_joints(urdf).items()}
    return SceneObject(file, urdf, pose, spec.fixed, rest | spec.joints)


def _find_urdf(name: Path, beside: Path, where: str) -> Path:
    files = [beside / name]
    if str(name) == name.name:
        files.append(_FOLDER / name)
    for file in files:
        with reading(file):
            if file.is_file():
                return file
    shipped = ", ".join(sorted(file.name for file in _FOLDER.glob("*.urdf")))
    raise KinfeasError(f"{where}: there is no file {str(beside / name)!r}; shipped are {shipped}")


def _check_primitives(urdf: Urdf, file: Path) -> None:
    if not any(link.shapes or link.mesh_collisions for link in urdf.links.values()):
        raise KinfeasError(f"{file}: has no <collision>")
    for link in urdf.links.values():
        if link.mesh_collisions:
            raise KinfeasError(
                f"{file}: link {link.name!r} has a collision mesh; objects of a scene have boxes, "
                "cylinders and spheres"
            )
    for name, joint in urdf.joints.items():
        if joint.mimic is not None:
            raise KinfeasError(f"{file}: joint {name!r} has <mimic>, which scenes do not support")


def _check_joints(urdf: Urdf, positions: Mapping[str, float], where: str) -> None:
    joints = free_joints(urdf)
    for name, position in positions.items():
        joint = _of(joints, name, f"{where}: there is no moving joint")
        if not joint.lower <= position <= joint.upper:
            raise KinfeasError(
                f"{where}: {name} must be in [{joint.lower:g}, {joint.upper:g}], not {position:g}"
            )


def _handle(spec: HandleSpec, objects: Mapping[str, SceneObject], where: str) -> Handle:
    urdf = _of(objects, spec.object, f"{where}.object': there is no object").urdf
    _of(urdf.links, spec.link, f"{where}.link': {spec.object!r} has no link")
    pose = _pose(spec.position, spec.rpy)
    return Handle(spec.object, spec.link, pose, moving_joint(urdf, spec.link))


def _of(entries: Mapping[str, T], name: str, complaint: str) -> T:
    if name not in entries:
        raise KinfeasError(f"{complaint} {name!r}{no_such(name, entries)}")
    return entries[name]


def _pose(position: Vector, rpy: Vector) -> Array:
    return make_pose(np.array(position), Rotation.from_euler("xyz", rpy))


def furniture_solids(
    scene: Scene, grasped: tuple[str, str] | None = None, *, movable: bool = False
) -> Solids:
    """Return the collision shapes of fixed objects, and of `movable` ones, as one row of solids.

    Links that move with the `grasped` one, an object and its link, are left out: solids do not
    turn.
    """
    shapes, (grasped_name, link) = list[Shape](), grasped or (None, "")
    for name, scene_object in scene.objects.items():
        joint = moving_joint(scene_object.urdf, link) if name == grasped_name else None
        moved = scene_object.urdf.below(joint) if joint else frozenset()
        if scene_object.fixed or movable:
            shapes += [shape for part, shape in scene_object.shapes() if part not in moved]
    return solids_around(shapes, np.array([shape.pose for shape in shapes]).reshape(1, -1, 7))


def solid_names(scene: Scene) -> list[str]:
    """Return the object's name for each solid of `furniture_solids` with `movable`."""
    return [name for name, entry in scene.objects.items() for _ in entry.shapes()]


def solids_around(shapes: Sequence[Shape], pose: Array) -> Solids:
    """Return the solids around k shapes at world poses of their centres, shape (n, k, 7).

    Upright boxes around them stand for shapes that are not upright.
    """
    solids = Solids.empty(*pose.shape[:2])
    matrix = rotation(pose.reshape(-1, 7)).as_matrix().reshape(*pose.shape[:2], 3, 3)
    half = np.array([shape.half for shape in shapes]).reshape(-1, 3)
    kinds = np.array([shape.kind for shape in shapes], dtype=np.str_)
    box, sphere = kinds == "box", kinds == "sphere"
    along = np.abs(matrix)
    round_ = np.hypot(along[..., 0], along[..., 1]) * half[:, :1] + along[..., 2] * half[:, 2:]
    reach = np.where(box[:, np.newaxis], (along @ half[..., np.newaxis])[..., 0], round_)
    reach = np.where(sphere[:, np.newaxis], half, reach)
    upright = along[..., 2, 2] >= _UPRIGHT  # also upside down
    turned = box & upright
    solids.pose[..., :2] = pose[..., :2]
    solids.pose[..., 2] = np.where(turned, np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]), 0.0)
    solids.size[..., :2] = np.where(turned[..., np.newaxis], half[:, :2], reach[..., :2])
    solids.size[..., 2:] = pose[..., 2:3] + reach[..., 2:] * [-1.0, 1.0]
    solids.cylinder[:] = sphere | (upright & ~box)
    return solids
