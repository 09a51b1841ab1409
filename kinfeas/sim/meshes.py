"""Where the meshes of a URDF lie."""

from pathlib import Path
from typing import Any

from kinfeas.robots.elements import Element

FORMATS = (".stl", ".obj", ".dae")
"""What PyBullet reads; of STL files, the binary ones."""

_PACKAGES, _FILES = ("package", "model"), ("", "file")


def place_meshes(robot: Any, urdf: Path) -> None:
    """Name every mesh by its absolute path, so that the text may be read from anywhere.

    What names a mesh is a path from the URDF's folder, a `file://` address, or `package://NAME/...`
    in the usual layout: the nearest folder above the URDF of that name, or beside one of these.

    Args:
        robot: The element <robot> of a URDF that has been checked; it is changed.
        urdf: The file that it is from.

    Raises:
        KinfeasError: If a mesh is not there, cannot be read or has another format.
    """
    for link in robot.findall("link"):
        where = f"{urdf}: link {link.get('name')!r}, <mesh>"
        for mesh in link.iterfind("*/geometry/mesh"):
            mesh.set("filename", str(_find(Element(mesh, where), urdf.absolute().parent)))


def _find(mesh: Element, folder: Path) -> Path:
    name = mesh.text("filename")
    if not name.lower().endswith(FORMATS):
        raise mesh.error(f"{name!r} must be of the format {', '.join(FORMATS)}")
    try:
        for path in _candidates(mesh, name, folder):
            if path.is_file():
                path.open("rb").close()
                return path
    except OSError as error:
        raise mesh.error(f"{name!r} cannot be read: {error.strerror or error}") from error
    raise mesh.error(f"there is no {name!r}, from the folder {str(folder)!r}")


def _candidates(mesh: Element, name: str, folder: Path) -> list[Path]:
    """Return where a mesh may lie, the likeliest first."""
    scheme, _, rest = name.rpartition("://")
    if scheme in _PACKAGES:
        return [above / rest for above in (*folder.parents, folder)]
    if scheme in _FILES:
        return [folder / rest]
    raise mesh.error(f"{name!r} must be a path, or begin with file:// or package://")
