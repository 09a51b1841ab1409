"""The triangles of mesh files."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.errors import KinfeasError
from kinfeas.core.plugin_errors import PluginErrors
from kinfeas.core.spatial import Array
from kinfeas.robots.elements import Element
from kinfeas.robots.meshes import find_mesh

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

    with PluginErrors(f"{where}: {str(path)!r} cannot be read as a mesh:"):
        scene = trimesh.load_scene(path)
        metres = trimesh.units.unit_conversion(scene.units or "meters", "meters")
        return np.asarray(scene.to_mesh().triangles, dtype=np.float64) * metres
    raise AssertionError  # the context raises, or the block returns
