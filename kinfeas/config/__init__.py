"""Configuration: YAML into frozen dataclasses, strictly, and back.

The dataclass is the schema; `kinfeas.config.schema` says which types its fields may have.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from kinfeas.config import strict_yaml
from kinfeas.config.schema import Interval, Place, convert_dataclass, default, init_fields, no_such
from kinfeas.core.errors import KinfeasError

__all__ = [
    "Interval",
    "dump",
    "from_mapping",
    "index_in",
    "load",
    "no_such",
    "plugin_errors",
    "to_mapping",
]

T = TypeVar("T")

_OPTION = "--set"
"""Where assignments stand as a rule, named in errors."""


def load(cls: type[T], path: Path, overrides: Sequence[str] = ()) -> T:
    """Return the configuration that a YAML file holds.

    Args:
        cls: Frozen dataclass to build.
        path: YAML file with a mapping.
        overrides: Assignments `a.b=c` that win over the file; `c` is YAML, and `a.0=c` changes the
            first entry of a list.

    Raises:
        KinfeasError: If the file is not readable YAML or an entry is not what `cls` allows.
    """
    return from_mapping(cls, strict_yaml.read(path), str(path), overrides)


def from_mapping(cls: type[T], data: object, source: str, overrides: Sequence[str] = ()) -> T:
    """Return `data`, as YAML gives it, as an instance of the dataclass `cls`.

    Args:
        cls: Frozen dataclass to build.
        data: Mapping of field names to plain values.
        source: What the data is from, named in errors; a file name as a rule.
        overrides: Assignments `a.b=c` that win over `data`; `c` is YAML.

    Raises:
        KinfeasError: If a key is unknown or missing, or a value has a wrong type or range.
    """
    place = Place(source)
    if overrides:
        data = copy.deepcopy(data)
        assignments = {}
        for text in overrides:
            assignments[_override(data, cls, text)] = f"{_OPTION} {text}"
        place = replace(place, overrides=assignments)
    result: T = convert_dataclass(cls, data, place)
    return result


def assigned(overrides: Sequence[str]) -> dict[str, object]:
    """Return assignments `a.b=c`, in which `c` is YAML, as nested mappings.

    Raises:
        KinfeasError: If one of them is malformed.
    """
    data: dict[str, object] = {}
    for text in overrides:
        _override(data, None, text)
    return data


@contextmanager
def plugin_errors(place: str) -> Iterator[None]:
    """Let errors in assignments name the `place` where they stand, which is no command line."""
    try:
        yield
    except KinfeasError as error:
        raise KinfeasError(str(error).replace(_OPTION, place, 1)) from error


def dump(config: object, path: Path) -> None:
    """Write a dataclass as a YAML file that `load` reads back.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    strict_yaml.write(to_mapping(config), path)


def to_mapping(config: object) -> dict[str, object]:
    """Return a dataclass as plain data that `from_mapping` reads back."""
    if not is_dataclass(config) or isinstance(config, type):
        raise TypeError(f"{config!r} is no instance of a dataclass")
    return {field.name: _plain(getattr(config, field.name)) for field in init_fields(config)}


def _plain(value: object) -> object:
    if is_dataclass(value) and not isinstance(value, type):
        return to_mapping(value)
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    # NumPy's float64 is a float that YAML does not know how to write.
    return float(value) if isinstance(value, float) else value


def index_in(entries: Sequence[object], key: object, place: Place) -> int:
    """Return which of the entries of a list at `place` a key of digits names.

    Raises:
        KinfeasError: If there is no such entry.
    """
    if str(key).isdecimal() and int(str(key)) < len(entries):
        return int(str(key))
    known = f"0 to {len(entries) - 1}" if entries else "none"
    raise place.error(f"unknown key {place.inner(key).key!r}; known are {known}")


def _override(data: object, cls: Any, text: str) -> str:
    """Carry out an assignment in the nested mappings and lists `data` and return its key."""
    key, value = _parse_override(text)
    *above, last = key.split(".")
    place = Place(f"{_OPTION} {text}")
    for name in above:
        data, cls = _inner(data, cls, name, place)
        place = place.inner(name)
    if isinstance(data, list):
        data[index_in(data, last, place)] = value
    elif isinstance(data, dict):
        data[last] = value
    else:
        raise _no_keys(place, last)
    return key


def _inner(data: object, cls: Any, key: str, place: Place) -> tuple[object, Any]:
    """Return the entry `key` of `data` and its dataclass, if any; absent blocks begin at defaults.

    Args:
        data: Mapping or list, changed in place.
        cls: Dataclass of `data`, or of the entries of a list, or None.
        key: Of a mapping, or an index.
        place: Of `data`.
    """
    if isinstance(data, list):
        return data[index_in(data, key, place)], cls
    if not isinstance(data, dict):
        raise _no_keys(place, key)
    if data.get(key) is None:
        block = _default_block(cls, key)
        data[key] = {} if block is None else block
    return data[key], _dataclass_in(cls, key)


def _no_keys(place: Place, key: str) -> KinfeasError:
    return place.error(f"unknown key {place.inner(key).key!r}, for {place.key!r} has no keys")


def _parse_override(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise KinfeasError(f"{_OPTION} {text}: must be of the form key=value or key.inner=value")
    return key.strip(), strict_yaml.parse(value, f"{_OPTION} {text}")


def _default_block(cls: Any, key: str) -> object:
    """Return the default of the field `key` as plain data, or None if there is none."""
    for field in init_fields(cls) if cls else []:
        if field.name == key and (value := default(field)) is not MISSING:
            return _plain(value)
    return None


def _dataclass_in(cls: Any, key: str) -> Any:
    """Return the one dataclass that the field `key` allows, or None."""
    kind = get_type_hints(cls).get(key) if cls else None
    options = [option for option in (kind, *get_args(kind)) if is_dataclass(option)]
    return options[0] if len(options) == 1 else None
