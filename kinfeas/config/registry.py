"""Plugins by name, from the entry points of installed distributions.

A plugin is loaded when its name is used, so that a broken plugin does not affect others.
"""

import inspect
import sys
import warnings
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field
from importlib.metadata import Distribution, EntryPoint, distribution, entry_points
from importlib.resources import files
from pathlib import Path
from types import FunctionType
from typing import Any

from kinfeas.config import convert
from kinfeas.config.strict_yaml import CODE
from kinfeas.core.errors import KinfeasError, no_such, plugin_note
from kinfeas.core.extras import missing_extra
from kinfeas.core.files import is_path

GROUPS = {
    "kinfeas.motion_generators": "motion generator",
    "kinfeas.robots": "robot",
    "kinfeas.tasks": "task",
    "kinfeas.adapters": "adapter",
    "kinfeas.backends": "backend",
    "kinfeas.policies": "policy",
    "kinfeas.filters": "command filter",
    "kinfeas.target_sources": "target source",
}
"""Entry-point groups and the noun for their entries."""

_PATHS = {"kinfeas.robots": ", or a folder", "kinfeas.tasks": ", or the path of a YAML file"}
_MEMBERS = {
    "kinfeas.tasks": ("name", "subgoals", "sample"),
    "kinfeas.adapters": ("reset", "step", "close"),
    "kinfeas.backends": ("reset", "step", "close"),
    "kinfeas.policies": ("act",),
    "kinfeas.filters": ("__call__",),
    "kinfeas.target_sources": ("start", "close"),
}
"""Required attributes; those of motion generators are called before an episode begins."""

_LOCAL = ("kinfeas.motion_generators", "kinfeas.policies", "kinfeas.target_sources")
"""Groups whose plugins may be given as `module:name`; robots and tasks are named in files."""

_SHIPPED = {"kinfeas.robots": "*/robot.yaml", "kinfeas.tasks": "*.yaml"}
"""Files of robots and tasks that come without entry points."""

_READ_TASK = "kinfeas.tasks.loading:read_chain"  # a name, since tasks import this module
_REGISTERED: list[EntryPoint] = []


class _Shipped(EntryPoint):
    """A shipped robot or task; `value` is its YAML file, whose first line is the title."""

    @property
    def dist(self) -> Distribution:  # type: ignore[override]
        return distribution("kinfeas")

    def load(self) -> Callable[..., Any]:
        """Return a function that returns the robot's folder or the task; its help is the title."""
        path = Path(self.value)

        def folder() -> Path:
            return path.parent

        def task(**parameters: object) -> Any:
            return EntryPoint("", _READ_TASK, "").load()(path, parameters)

        made = folder if self.group == "kinfeas.robots" else task
        with path.open(encoding="utf-8") as file:
            made.__doc__ = file.readline().strip("# \n")
        return made


@dataclass(frozen=True)
class Plugin:
    """An entry point and its distribution."""

    group: str  # key of `GROUPS`
    name: str  # name of the entry
    distribution: str  # name of the distribution
    version: str  # version of the distribution
    target: str = field(default="", compare=False)  # class or function, as `module:name`

    def __str__(self) -> str:
        origin = f" ({self.distribution} {self.version})" if self.distribution != "?" else ""
        return f"{GROUPS[self.group]} {self.name!r}{origin}"


def register(group: str, name: str, factory: type | FunctionType) -> None:
    """Register a class or function in this process, without an entry point.

    For scripts and notebooks. A second call with the same name replaces the first registration.

    Raises:
        KinfeasError: If the group is unknown, an installed distribution has that name, or
            `factory` is not at the top level of a module.
    """
    if any(entry.name == name and entry not in _REGISTERED for entry in _entries(group)):
        raise KinfeasError(f"{GROUPS[group]} {name!r} is installed already; choose another name")
    if not factory.__qualname__.isidentifier():
        raise KinfeasError(f"{factory.__qualname__} must be at the top level of its module")
    target = f"{factory.__module__}:{factory.__qualname__}"
    _REGISTERED[:] = [entry for entry in _REGISTERED if (entry.group, entry.name) != (group, name)]
    _REGISTERED.append(EntryPoint(name, target, group))


def plugins(group: str) -> list[Plugin]:
    """Return all entries of a group, sorted by name, without importing any of them."""
    entries = map(_plugin, _entries(group))
    return sorted(entries, key=lambda plugin: (plugin.name, plugin.distribution))


def is_ignored(plugin: Plugin) -> bool:
    """Return whether kinfeas has a plugin of the same name, which is used in its place."""
    same = [entry for entry in _entries(plugin.group) if entry.name == plugin.name]
    return plugin.distribution != "kinfeas" and "kinfeas" in (_plugin(e).distribution for e in same)


def names(group: str) -> list[str]:
    """Return the sorted names of a group."""
    return sorted({entry.name for entry in _entries(group)})


def load(group: str, name: str) -> Any:
    """Return a class or function; raise KinfeasError if it is unknown, ambiguous or broken."""
    return _import(_find(group, name))


def build(
    group: str,
    name: str,
    parameters: Mapping[str, object],
    offered: Mapping[str, object] | None = None,
) -> Any:
    """Return the object that a plugin's class or function builds from keyword parameters.

    `name` is an entry point of the group; or `module:name` of a motion generator, policy or target
    source, which is also searched for in the working directory. Files must not name the latter.
    Parameters are as in YAML and converted to their annotated types, such as a Path or a dataclass.
    `offered` objects of the run are passed unchanged, if the factory has parameters of their names.

    Raises:
        KinfeasError: As `load`; also if a parameter is unknown, missing, invalid or offered by the
            run, or the object lacks a method of its group.
    """
    if group in _LOCAL and CODE.fullmatch(name):
        entry = EntryPoint(name, name, group)
        if str(Path.cwd()) not in sys.path:
            sys.path.append(str(Path.cwd()))
    else:
        entry = _find(group, name)
    factory, subject = _import(entry), str(_plugin(entry))
    try:
        signature = _signature(factory)
    except (ValueError, TypeError) as error:
        raise KinfeasError(f"{subject}: {error}") from error
    objects = {key: each for key, each in (offered or {}).items() if key in signature.parameters}
    for key in objects.keys() & parameters.keys():
        raise KinfeasError(f"{GROUPS[group]} {name!r}: the run sets the parameter {key!r}")
    typed = _in_types(signature, parameters, subject, objects)
    try:
        with plugin_note(subject):
            built = factory(**objects, **typed)
    except (ValueError, TypeError, ImportError) as error:
        raise KinfeasError(f"{subject}: {missing_extra(error) or error}") from error
    except SystemExit as error:
        raise KinfeasError(f"{subject} raised SystemExit: {error}") from error
    if lacks := [name for name in _MEMBERS.get(group, ()) if not hasattr(built, name)]:
        raise KinfeasError(
            f"{subject} must return an object with {', '.join(lacks)}, not {type(built).__name__}"
        )
    return built


def from_anywhere(name_or_path: str) -> str:
    """Return the absolute form of a path; names are returned unchanged."""
    return str(Path(name_or_path).absolute()) if is_path(name_or_path) else name_or_path


def _signature(factory: Any) -> inspect.Signature:
    try:
        return inspect.signature(factory, eval_str=True)
    # Annotations may use names that are imported for type checkers only.
    except (NameError, AttributeError, SyntaxError, TypeError):
        return inspect.signature(factory)


def _in_types(
    signature: inspect.Signature,
    values: Mapping[str, object],
    subject: str,
    taken: Container[str],
) -> dict[str, object]:
    """Return values converted to the annotated types of a signature; the run sets those `taken`."""
    typed = dict(values)
    parameters = {key: each for key, each in signature.parameters.items() if key not in taken}
    if all(parameter.kind is not parameter.VAR_KEYWORD for parameter in parameters.values()):
        for name in sorted(values.keys() - parameters.keys()):
            raise KinfeasError(f"{subject}: unknown parameter {name!r}{no_such(name, parameters)}")
    for name in values.keys() & parameters.keys():
        value, parameter = values[name], parameters[name]
        if value is not parameter.default:
            typed[name] = convert(parameter.annotation, value, subject, name)
    return typed


def _entries(group: str) -> list[EntryPoint]:
    if group not in GROUPS:
        raise KinfeasError(f"unknown plugin group {group!r}{no_such(group, GROUPS)}")
    own = [entry for entry in _REGISTERED if entry.group == group]
    if pattern := _SHIPPED.get(group):
        for path in Path(str(files(group))).glob(pattern):
            name = path.parent.name if path.name == "robot.yaml" else path.stem
            own.append(_Shipped(name, str(path), group))
    return [*entry_points(group=group), *own]


def _find(group: str, name: object) -> EntryPoint:
    matches = [entry for entry in _entries(group) if entry.name == name]
    if not matches:
        known = no_such(str(name), names(group)) + _PATHS.get(group, "")
        raise KinfeasError(f"unknown {GROUPS[group]} {name!r}{known}")
    if len(matches) > 1:
        subject = f"{GROUPS[group]} {name!r}"
        owners = [_plugin(entry).distribution for entry in matches]
        if owners.count("kinfeas") != 1:
            several = " and ".join(sorted(owners))
            raise KinfeasError(f"{subject} exists in {several}; uninstall all but one")
        others = " and ".join(sorted(set(owners) - {"kinfeas"}))
        warnings.warn(f"{subject} of {others} is ignored: kinfeas has one", stacklevel=2)
        return matches[owners.index("kinfeas")]
    return matches[0]


def _plugin(entry: EntryPoint) -> Plugin:
    distribution, version = (entry.dist.name, entry.dist.version) if entry.dist else ("?", "?")
    # Name and version are None after an incomplete removal.
    return Plugin(entry.group, entry.name, distribution or "?", version or "?", entry.value)


def _import(entry: EntryPoint) -> Any:
    try:
        factory = entry.load()
    except (Exception, SystemExit) as error:  # the code of others, run on import
        reason = missing_extra(error) or f"{type(error).__name__}: {error}"
        raise KinfeasError(f"{_plugin(entry)} cannot be loaded: {reason}") from error
    if not callable(factory):
        kind = type(factory).__name__
        raise KinfeasError(f"{_plugin(entry)} must be a class or function, not {kind}")
    return factory
