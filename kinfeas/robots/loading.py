"""Robots by name or path."""

import shlex
from pathlib import Path

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import is_path
from kinfeas.robots.reading import read_robot
from kinfeas.robots.robot import Robot


def load_robot(name_or_path: str) -> Robot:
    """Return the robot of a YAML file (`my/robot.yaml`) or of an entry point (`pr2`).

    Raises:
        KinfeasError: If there is no such robot, its YAML or URDF is wrong, or a URDF is named in
            place of the YAML.
    """
    check_no_urdf(name_or_path)
    path = Path(name_or_path) if is_path(name_or_path) else _robot_yaml(name_or_path)
    return read_robot(path)


def _robot_yaml(name: str) -> Path:
    built = registry.build("kinfeas.robots", name, {})
    if not isinstance(built, Path):
        raise KinfeasError(f"robot {name!r} must return the Path of its YAML, not {built!r}")
    return built


def check_no_urdf(name_or_path: object) -> None:
    """Check that what is to name a robot is no URDF, nor what becomes one.

    Raises:
        KinfeasError: If it is; it tells the command that makes the YAML.
    """
    path = Path(str(name_or_path))
    if path.suffix.lower() not in (".urdf", ".xacro"):
        return
    urdf, first = path, ""
    if path.suffix.lower() == ".xacro":
        urdf = path.with_suffix("" if path.stem.endswith(".urdf") else ".urdf")
        first = f"{shlex.join(['xacro', str(path)])} > {shlex.quote(str(urdf))} and then "
    command = shlex.join(["kinfeas", "robot", "import", str(urdf), "--out", "FOLDER"])
    raise KinfeasError(f"{path}: a robot is a YAML file, which {first}{command} writes")
