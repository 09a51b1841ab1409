"""Recipes: YAML files that come with the package, by name, and the user's own, by path."""

from importlib.resources import files
from pathlib import Path

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.io.files import is_path

_SUFFIX = ".yaml"


def recipes(folder: str) -> list[str]:
    """Return the names of the recipes that come with the package in a folder, such as `train`."""
    place = _root() / folder
    return sorted(
        path.relative_to(_root()).with_suffix("").as_posix() for path in place.glob(f"*{_SUFFIX}")
    )


def find_recipe(name: str, folder: str, prefix: str = "") -> Path:
    """Return the file of a recipe.

    Args:
        name: Path of a YAML file, or the name of a recipe that comes with the package.
        folder: Where such names are listed from, for the error.
        prefix: What such names begin with that `name` lacks, such as `sim2real/`.

    Raises:
        KinfeasError: If there is neither.
    """
    if (own := Path(name)).is_file():
        return own
    shipped = _root() / f"{prefix}{name.removesuffix(_SUFFIX)}{_SUFFIX}"
    if not shipped.is_file() or not shipped.resolve().is_relative_to(_root().resolve()):
        names = [one.removeprefix(prefix) for one in recipes(folder)]
        if name and (own.is_dir() or _is_file_name(name)):
            wrong = "is a folder" if own.is_dir() else "there is no such file"
            raise KinfeasError(f"{name}: {wrong}; known by name are {', '.join(sorted(names))}")
        raise KinfeasError(f"unknown configuration {name!r}{no_such(name, names)}, or a file")
    return shipped


def default_recipe(folder: str, robot: str) -> Path:
    """Return the recipe of a robot by its name, or the one for any robot."""
    own = _root() / folder / f"{robot}{_SUFFIX}"
    return own if robot == Path(robot).name and own.is_file() else _root() / folder / "default.yaml"


def _is_file_name(name: str) -> bool:
    """Return whether a path is meant, and no name, which may begin with one of our folders."""
    folders = [one.name for one in _root().iterdir() if one.is_dir()]
    return is_path(name) and Path(name).parts[0] not in folders


def _root() -> Path:
    # The package is installed as plain files, never zipped: numba caches its kernels beside them.
    return Path(str(files("kinfeas.configs").joinpath("")))
