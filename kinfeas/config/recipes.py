"""Recipes by name or path, and the sections of a robot's `recipes.yaml`."""

from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from kinfeas.config import Settings, from_mapping, merged, registry, strict_yaml
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import is_path

T = TypeVar("T")

ENGINES = ("pybullet", "mujoco")
"""Backends with physics, the default one first; each is named like the module that it needs."""

# The package is installed as plain files: numba caches its kernels beside them.
_ROOT = Path(str(files("kinfeas.configs").joinpath(""))).resolve()
_DEFAULT = _ROOT / "default.yaml"


def recipes(folder: str) -> list[str]:
    """Return the names of the shipped recipes in a folder of `configs`, such as `paper/pr2`."""
    return sorted(f"{folder}/{path.stem}" for path in (_ROOT / folder).glob("*.yaml"))


def find_recipe(name: str, folder: str, within: Path = Path()) -> Path:
    """Return the file of a recipe: a path, or a shipped one, such as `paper/pr2` or `pr2`.

    Names without a folder are those in the shipped `folder`; paths are relative to `within`.
    """
    shipped = (_ROOT / f"{stem}.yaml" for stem in (name, f"{folder}/{name}"))
    inside = (path for path in shipped if path.resolve().parent.parent == _ROOT)
    for path in (within / name, *inside):
        if path.is_file():
            return path
    names = [recipe.removeprefix(f"{folder}/") for recipe in recipes(folder)]
    raise KinfeasError(f"unknown configuration {name!r}{no_such(name, names)}, or a YAML file")


def read_recipe(
    name: str, within: Path = Path(), above: Sequence[Path] = ()
) -> tuple[dict[str, Any], str | None]:
    """Return the keys of a training recipe, and the section of its robot that has all others.

    Args:
        name: Section such as `train_rooms`, shipped recipe such as `paper/pr2`, or path of a file.
            The key `extends` of a file names another recipe, which supplies the keys that the file
            lacks.
        within: Folder of relative paths.
        above: Files that extend this recipe.

    Returns:
        The keys, and the section; None where no section is named.

    Raises:
        KinfeasError: If there is no such recipe, or it extends itself.
    """
    trainings = [key for key in strict_yaml.read(_DEFAULT) if "train" in key or "tune" in key]
    if name in trainings:
        return {}, name
    try:
        path = find_recipe(name, ".", within)
    except KinfeasError:
        hint = no_such(name, [*trainings, *recipes("paper")])
        raise KinfeasError(f"unknown recipe {name!r}{hint}, or a YAML file") from None
    data = strict_yaml.read(path)
    if (extended := data.pop("extends", None)) is None:
        return data, None
    if not isinstance(extended, str):
        raise KinfeasError(f"{path}: 'extends' must be the name or path of a recipe")
    if path.resolve() in above:
        raise KinfeasError(f"{path}: 'extends' itself")
    try:
        keys, completed = read_recipe(extended, path.parent, [*above, path.resolve()])
    except KinfeasError as error:
        raise KinfeasError(f"{path}: extends: {error}") from error
    return merged(keys, data), completed


def section(name: str, robot: str | Path | None = None) -> tuple[dict[str, Any], str]:
    """Return a robot's settings in a section, and their source for errors.

    The sections of `configs/default.yaml` are `train`, `train_rooms`, `train_physics`,
    `finetune_physics`, `deploy`, `servo`, `baselines`, and the settings of evaluations: `analytic`,
    `physics` for all engines, and `sim2real` with adapters. The `recipes.yaml` in the robot's
    folder overrides their keys. The name may also be a backend; its settings are empty if neither
    file has such a section. Without a robot the settings are the default ones.
    """
    name = "physics" if name in ENGINES else name
    default, path = strict_yaml.read(_DEFAULT), _DEFAULT
    own: dict[str, Any] = {}
    if robot is not None and (path := robot_file(robot).with_name("recipes.yaml")).is_file():
        own = strict_yaml.read(path)
        for unknown in own.keys() - default.keys():
            raise KinfeasError(f"{path}: unknown key {unknown!r}{no_such(unknown, default)}")
    return merged(default.get(name, {}), own.get(name) or {}), f"{path}: {name}"


def load_section(cls: type[T], name: str, robot: str | Path, settings: Settings | None = None) -> T:
    """Return a robot's settings in a section as an instance of the dataclass `cls`."""
    return from_mapping(cls, *section(name, robot), settings)


def robot_file(robot: str | Path) -> Path:
    """Return the `robot.yaml` of a robot.

    Args:
        robot: Name of an entry point, which returns a path; or the path of the robot's folder or of
            the file, with at least one slash.

    Raises:
        KinfeasError: If the robot is unknown or its entry point returns no path.
    """
    path: object = robot
    if not is_path(robot):
        name = str(robot)  # notebooks may pass other types
        if name not in registry.names("kinfeas.robots") and Path(name).is_dir():
            raise KinfeasError(f"unknown robot {name!r}; the folder is ./{name}")
        path = registry.build("kinfeas.robots", name, {})
    if not isinstance(path, str | Path):
        raise KinfeasError(f"robot {robot!r} must return the Path of its folder, not {path!r}")
    return Path(path) / "robot.yaml" if Path(path).is_dir() else Path(path)


def default_engine() -> str:
    """Return the first of `ENGINES` that is installed, or else the first."""
    return next((engine for engine in ENGINES if find_spec(engine)), ENGINES[0])
