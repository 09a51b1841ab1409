"""Shipped configuration: sections of the robots' files, and recipes by name or path."""

import sys
from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from kinfeas.config import Settings, from_mapping, merged, strict_yaml
from kinfeas.core.errors import KinfeasError, no_such

T = TypeVar("T")

ENGINES = ("pybullet", "mujoco")
"""Backends with physics, the default one first; each is named like the module that it needs."""

# The package is installed as plain files: numba caches its kernels beside them.
_ROOT = Path(str(files("kinfeas.configs").joinpath("")))
_ROBOTS = _ROOT / "robots"


def recipes(folder: str) -> list[str]:
    """Return the names of the shipped recipes of a folder or section: `paper/pr2`, `train/pr2`."""
    place = _ROBOTS if folder in _read_robot("default") else _ROOT / folder
    return sorted(f"{folder}/{path.stem}" for path in place.glob("*.yaml"))


def find_recipe(name: str, folder: str, within: Path = Path()) -> Path:
    """Return the file of a recipe: a path, or a shipped one, such as `paper/pr2` or `pr2`.

    Names without a folder are those in the shipped `folder`; paths are relative to `within`.
    """
    shipped = [_ROOT / f"{stem}.yaml" for stem in (name, f"{folder}/{name}")]
    for path in (within / name, *(one for one in shipped if one.resolve().is_relative_to(_ROOT))):
        if path.is_file():
            return path
    files = (_ROOT / folder).is_dir()
    names = [one.removeprefix(f"{folder}/") if files else one for one in recipes(folder)]
    names += [] if files else recipes("paper")
    raise KinfeasError(f"unknown configuration {name!r}{no_such(name, names)}, or a YAML file")


def read_recipe(
    name: str, folder: str, within: Path = Path(), above: Sequence[Path] = ()
) -> tuple[dict[str, Any], bool]:
    """Return the keys of a recipe, over those of the one that it `extends`, if there is one.

    Args:
        name: As in `find_recipe`, or `train/pr2` for the section `train` of a robot.
        folder: Section, or folder of shipped recipes, of names without one.
        within: Folder of relative paths.
        above: Files that extend this recipe.

    Returns:
        The keys, and whether they come from the section of a robot, and so are complete.

    Raises:
        KinfeasError: If there is no such recipe, or it extends itself.
    """
    for section_name in (name, f"{folder}/{name}"):
        kind, _, robot = section_name.partition("/")
        if kind in _read_robot("default") and section_name in recipes(kind):
            own = {} if robot == "default" else {"robot": robot}
            return {**own, **section(kind, robot)[0]}, True
    path = find_recipe(name, folder, within)
    data = strict_yaml.read(path)
    if (extended := data.pop("extends", None)) is None:
        return data, False
    if not isinstance(extended, str):
        raise KinfeasError(f"{path}: 'extends' must be the name or path of a recipe")
    if path.resolve() in above:
        raise KinfeasError(f"{path}: 'extends' itself")
    try:
        keys, complete = read_recipe(extended, folder, path.parent, [*above, path.resolve()])
    except KinfeasError as error:
        raise KinfeasError(f"{path}: extends: {error}") from error
    return merged(keys, data), complete


def section(name: str, robot: str) -> tuple[dict[str, Any], str]:
    """Return a robot's settings in a section of `configs/robots`, and their source for errors.

    The robot's file, if there is one, changes keys of the same section of `default.yaml`: `train`,
    `train_physics`, `finetune_physics`, `deploy`, `baselines`, or a backend, whose section has the
    settings of evaluations; all engines have the section `physics`.
    """
    name = "physics" if name in ENGINES else name
    data = merged(_read_robot("default").get(name, {}), _read_robot(robot).get(name, {}))
    return data, f"configs/robots/{robot}.yaml, {name}"


def load_section(cls: type[T], name: str, robot: str, settings: Settings | None = None) -> T:
    """Return a robot's settings in a section as an instance of the dataclass `cls`."""
    return from_mapping(cls, *section(name, robot), settings)


def _read_robot(name: str) -> dict[str, Any]:
    """Return the sections of a robot's shipped file, if it has one."""
    path = _ROBOTS / f"{name}.yaml"
    return strict_yaml.read(path) if name == Path(name).name and path.is_file() else {}


def default_engine() -> str:
    """Return the first of `ENGINES` that is installed, or else the first with wheels."""
    installable = ENGINES[sys.version_info >= (3, 12)]
    return next((one for one in ENGINES if find_spec(one)), installable)
