"""Distributions written from the templates in this folder."""

import keyword
import re
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from string import Template

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import writing

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
# The suffix hides templates from tools that check Python files.
_SUFFIX, _PLACEHOLDER = ".txt", "NAME"


class Kind(StrEnum):
    """Kinds of plugins with a template."""

    MOTION_GENERATOR = "motion_generator"
    ROBOT = "robot"
    TASK = "task"
    ADAPTER = "adapter"
    BACKEND = "backend"
    POLICY = "policy"
    FILTER = "filter"
    TARGET_SOURCE = "target_source"

    @property
    def group(self) -> str:
        """Entry-point group."""
        return "kinfeas.policies" if self is Kind.POLICY else f"kinfeas.{self}s"

    @property
    def target(self) -> str:
        """Class or function in the module, with the placeholders $Class and $name."""
        return "$name" if self in (Kind.ROBOT, Kind.TASK) else "$Class"


def write_distribution(kind: str, name: str, folder: Path) -> list[Path]:
    """Write a new distribution with one plugin of a `Kind`, and return its files.

    The name is in lower case; the folder is empty or missing.
    """
    kinds = {member.value: member for member in Kind}
    if kind not in kinds:
        raise KinfeasError(f"unknown kind of plugin {kind!r}{no_such(kind, kinds)}")
    group, class_name = kinds[kind].group, "".join(part.capitalize() for part in name.split("_"))
    _check_name(group, name, class_name)
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise KinfeasError(f"{folder}: not an empty or a new folder")
    words = {"name": name, "Class": class_name, "dashed": name.replace("_", "-")}
    words["target"] = Template(kinds[kind].target).substitute(words)
    words |= {"package": f"kinfeas_{name}", "group": group, "what": registry.GROUPS[group]}
    written = []
    for source, target in _files(kind):
        path = folder / target.replace(_PLACEHOLDER, name)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            text = Template(source.read_text(encoding="utf-8")).substitute(words)
            path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _check_name(group: str, name: str, class_name: str) -> None:
    if not _NAME.fullmatch(name) or keyword.iskeyword(name) or keyword.iskeyword(class_name):
        raise KinfeasError(
            f"{name!r}: a name has lower-case letters, digits and single _, such as my_motion, and "
            "is no keyword of Python"
        )
    taken = [plugin for plugin in registry.plugins(group) if plugin.name == name]
    if taken:
        raise KinfeasError(f"the name is taken by {taken[0]}; choose another")


def _files(kind: str) -> Iterator[tuple[Path, str]]:
    """Yield the template and the relative path of each file."""
    for folder_name in ("common", kind):
        root = Path(__file__).parent / folder_name
        for source in sorted(root.rglob(f"*{_SUFFIX}")):
            yield source, source.relative_to(root).as_posix().removesuffix(_SUFFIX)
