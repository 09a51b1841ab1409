"""Plugins by name: what the entry points of installed distributions offer.

Everything is looked up lazily and one name at a time, so that a broken plugin disturbs no other.
"""

import reprlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import FunctionType
from typing import Any

from kinfeas.core.checks.parameters import check_names, in_types, signature_of
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.plugin_errors import PluginErrors
from kinfeas.io.files import is_path

GROUPS = {
    "kinfeas.motion_generators": "motion generator",
    "kinfeas.robots": "robot",
    "kinfeas.tasks": "task",
    "kinfeas.adapters": "adapter",
    "kinfeas.backends": "backend",
    "kinfeas.filters": "command filter",
}
"""The entry-point groups, and what one entry of each is called."""

# What may be named by the path of a file, too.
_FILES = ("kinfeas.robots", "kinfeas.tasks")

# Motion generators are looked at when they begin.
_METHODS = {
    "kinfeas.tasks": ("sample",),
    "kinfeas.adapters": ("reset", "step", "close"),
    "kinfeas.backends": ("reset", "step", "close"),
    "kinfeas.filters": ("reset", "__call__"),
}

_REGISTERED: list[EntryPoint] = []


@dataclass(frozen=True)
class Plugin:
    """One entry of a group and the distribution that it comes from.

    Attributes:
        group: One of `GROUPS`.
        name: Name of the entry.
        distribution: Who offers it.
        version: Of the distribution.
        target: The class or function, as `module:name`.
    """

    group: str
    name: str
    distribution: str
    version: str
    target: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{GROUPS[self.group]} {self.name!r} ({self.distribution} {self.version})"


def register(group: str, name: str, factory: type | FunctionType) -> None:
    """Offer a class or function of this process by name, beside what is installed.

    For scripts and notebooks; processes that are started later do not know of it. A second call
    with the same name replaces the first one.

    Args:
        group: One of `GROUPS`.
        name: Name to find it by.
        factory: What an entry point would name: it must stand at the top of its module.

    Raises:
        KinfeasError: If there is no such group, an installed distribution offers that name, or
            `factory` is not at the top of a module.
    """
    if any(entry.name == name and entry not in _REGISTERED for entry in _entries(group)):
        raise KinfeasError(f"{GROUPS[group]} {name!r} is installed already; choose another name")
    if "." in factory.__qualname__:
        raise KinfeasError(f"{factory.__qualname__} must stand at the top of its module")
    target = f"{factory.__module__}:{factory.__qualname__}"
    _REGISTERED[:] = [entry for entry in _REGISTERED if (entry.group, entry.name) != (group, name)]
    _REGISTERED.append(EntryPoint(name, target, group))


def plugins(group: str) -> list[Plugin]:
    """Return all entries of a group, sorted by name, without importing any of them."""
    found = [_plugin(entry) for entry in _entries(group)]
    return sorted(found, key=lambda plugin: (plugin.name, plugin.distribution))


def names(group: str) -> list[str]:
    """Return the sorted names of a group."""
    return sorted({entry.name for entry in _entries(group)})


def check_unique(group: str, name: str) -> None:
    """Raise if `name` is unknown in a group or claimed twice, as `load` does."""
    _find(group, name)


def load(group: str, name: str) -> Any:
    """Return the class or function that `name` stands for in a group of `GROUPS`.

    Raises:
        KinfeasError: If the name is unknown or claimed twice, or if its module does not import.
    """
    return _import(_find(group, name))


def build(group: str, name: str, parameters: Mapping[str, object]) -> Any:
    """Return what the class or function `name` makes of keyword parameters.

    Args:
        group: One of `GROUPS`.
        name: Name of an entry point.
        parameters: Keyword parameters, as a YAML block gives them; it is given what that makes of
            them in the types that they are annotated with, such as a Path or a dataclass.

    Raises:
        KinfeasError: As `load`; also if a parameter is unknown, missing, refused or not of the
            type that it is annotated with, or if what is made is nothing of that kind.
    """
    entry = _find(group, name)
    factory, subject = _import(entry), _plugin(entry)
    if not callable(factory):
        kind = type(factory).__name__
        raise KinfeasError(f"{subject} must be a class or a function, not {kind}")
    with PluginErrors(f"{subject} fails:", _package(entry)):
        with _refusing(subject):
            signature = signature_of(factory)
            check_names(signature, parameters)
        typed = in_types(signature, parameters, str(subject))
        with _refusing(subject):
            built = factory(**typed)
    _check_methods(built, group, str(subject))
    return built


def from_anywhere(name_or_path: str) -> str:
    """Return a path as an absolute one, to be read from another folder later, and a name as is."""
    return str(Path(name_or_path).absolute()) if is_path(name_or_path) else name_or_path


def _entries(group: str) -> list[EntryPoint]:
    if group not in GROUPS:
        raise KinfeasError(f"unknown plugin group {group!r}{no_such(group, GROUPS)}")
    own = [entry for entry in _REGISTERED if entry.group == group]
    return [*entry_points(group=group), *own]


def _find(group: str, name: object) -> EntryPoint:
    if not isinstance(name, str):
        known = ", ".join(names(group)) + (" or the path of a YAML file" if group in _FILES else "")
        raise KinfeasError(f"{GROUPS[group]} must be one of {known}, not {reprlib.repr(name)}")
    matches = [entry for entry in _entries(group) if entry.name == name]
    if not matches:
        raise KinfeasError(f"unknown {GROUPS[group]} {name!r}{no_such(name, names(group))}")
    if len(matches) > 1:
        owners = " and ".join(sorted(_plugin(entry).distribution for entry in matches))
        raise KinfeasError(
            f"{GROUPS[group]} {name!r} is claimed by {owners}; uninstall all but one"
        )
    return matches[0]


def _plugin(entry: EntryPoint) -> Plugin:
    distribution, version = (entry.dist.name, entry.dist.version) if entry.dist else ("?", "?")
    # One that was half removed has neither.
    return Plugin(entry.group, entry.name, distribution or "?", version or "?", entry.value)


def _import(entry: EntryPoint) -> Any:
    subject = f"{_plugin(entry)} cannot be loaded:"
    if entry.pattern.match(entry.value) is None:
        raise KinfeasError(f"{subject} its entry point must be module:name, not {entry.value!r}")
    # Whatever an outside module does on import is its own affair.
    with PluginErrors(subject, _package(entry)):
        return entry.load()


def _package(entry: EntryPoint) -> str:
    """Return the top-level package of an entry's code."""
    return entry.value.partition(":")[0].partition(".")[0].strip()


@contextmanager
def _refusing(subject: Plugin) -> Iterator[None]:
    """Turn what a constructor refuses its parameters with into an error that names the plugin."""
    try:
        yield
    except (ValueError, TypeError) as error:
        raise KinfeasError(f"{subject}: {error}") from error


def _check_methods(built: object, group: str, subject: str) -> None:
    """Raise if what an entry has made lacks a method that all of its kind have."""
    lacks = [name for name in _METHODS.get(group, ()) if not callable(getattr(built, name, None))]
    if lacks:
        words, got = ", ".join(lacks), type(built).__name__
        raise KinfeasError(f"{subject} must return an object with the methods {words}, not {got}")
