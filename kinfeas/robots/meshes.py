"""Where the meshes of a URDF lie."""

from collections.abc import Sequence
from pathlib import Path

from kinfeas.robots.elements import Element

_PACKAGES, _FILES = ("package", "model"), ("", "file")


def find_mesh(mesh: Element, folder: Path, formats: Sequence[str]) -> Path:
    """Return the file that an element <mesh> names.

    What names it is a path from the URDF's folder, a `file://` address, or `package://NAME/...` in
    the usual layout: the nearest folder above the URDF of that name, or beside one of these.

    Args:
        mesh: The element.
        folder: Where the URDF lies, an absolute path.
        formats: What its file may end with, such as `.stl`.

    Raises:
        KinfeasError: If the file is not there, cannot be read or has another format.
    """
    name = mesh.text("filename")
    if not name.lower().endswith(tuple(formats)):
        raise mesh.error(f"{name!r} must be of the format {', '.join(formats)}")
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
        return [above / rest.lstrip("/") for above in (*folder.parents, folder)]
    if scheme in _FILES:
        return [folder / rest]
    raise mesh.error(f"{name!r} must be a path, or begin with file:// or package://")
