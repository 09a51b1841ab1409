"""Configuration: YAML files and settings as frozen dataclasses, and back.

A dataclass is the schema. Pydantic validates its fields in strict mode: unknown keys, values of
another type, NaN and infinity raise an error with the path of the key. `core.quantities` defines
numbers with bounds. A dataclass checks relations of its fields in `__post_init__` and raises
ValueError.

Settings are values by key, which change a file before it is validated. Keys are nested, or joined
by dots as in `world.dt`; `layers.0` is the first entry of a list in the file. An empty mapping
replaces the file's mapping; other mappings are merged into it.
"""

import json
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args, get_type_hints

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError, no_such

if TYPE_CHECKING:  # takes 0.1 s to import
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

T = TypeVar("T")
Settings = Mapping[str, object]


@dataclass(frozen=True)
class PluginSpec:
    """A plugin by its entry-point name, with its keyword parameters.

    In YAML, `velocity_clamp` is short for `{name: velocity_clamp}`. Parameters are keys beside
    `name`, or below `parameters`: `{name: obstacle_distance, min_distance: 0.03}`.
    """

    name: str
    parameters: dict[str, object] = field(default_factory=dict)

    @classmethod
    def read(cls, data: object) -> "PluginSpec":
        """Return the plugin that plain data describe; raise ValueError if they are invalid."""
        entry = {"name": data} if isinstance(data, str) else data
        if not isinstance(entry, Mapping) or not isinstance(entry.get("name"), str):
            raise ValueError("must be a name, or a mapping with the key 'name'")
        flat = {key: value for key, value in entry.items() if key not in ("name", "parameters")}
        below = entry.get("parameters", {})
        if not isinstance(below, Mapping):
            raise ValueError("'parameters' must be a mapping")
        return cls(entry["name"], {**below, **flat})

    def entry(self) -> dict[str, object]:
        """Return the plugin as an entry of a list in YAML."""
        return {"name": self.name, **self.parameters}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> Any:
        """Return the schema by which pydantic reads the short forms."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(cls.read)


def load(cls: type[T], path: Path, settings: Settings | None = None) -> T:
    """Return a YAML file as an instance of the dataclass `cls`; arguments as in `from_mapping`."""
    return from_mapping(cls, strict_yaml.read(path), str(path), settings)


def from_mapping(cls: type[T], data: Any, source: str, settings: Settings | None = None) -> T:
    """Return plain data, changed by settings, as an instance of the dataclass `cls`.

    Errors name the `source` of the data, such as a file.

    Raises:
        KinfeasError: If a key is unknown or missing, or a value has a wrong type or range.
    """
    changes = nested(settings)
    return validated(cls, merged(data, changes), source, changes=changes)


def convert(kind: Any, value: object, source: str, key: str) -> Any:
    """Return the plain value of a key as an instance of the type `kind`.

    NumPy numbers are converted to plain ones. Values that YAML cannot express are returned
    unchanged, and so are values of types that pydantic cannot validate.
    """
    import numpy as np  # slow to import, as pydantic
    from pydantic import PydanticUndefinedAnnotation, PydanticUserError

    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, str | bool | int | float | list | dict | None):
        return value
    try:
        return validated(kind, value, source, key)
    except (PydanticUserError, PydanticUndefinedAnnotation):
        return value


def to_mapping(config: object) -> dict[str, Any]:
    """Return a dataclass as plain data that `from_mapping` reads back."""
    from pydantic_core import to_jsonable_python

    return cast("dict[str, Any]", to_jsonable_python(config, fallback=_of_numpy))


def dump(config: object, path: Path) -> None:
    """Write a dataclass as a YAML file that `load` reads back."""
    strict_yaml.write(to_mapping(config), path)


def nested(*sources: Settings | None) -> dict[str, Any]:
    """Return settings as nested mappings; later values of a key override earlier ones."""
    data: dict[str, Any] = {}
    for settings in filter(None, sources):
        if not isinstance(settings, Mapping) or not all(isinstance(key, str) for key in settings):
            raise KinfeasError(f"settings must be values by key, not {reprlib.repr(settings)}")
        for path, value in settings.items():
            for key in reversed(path.split(".")):
                value = {key: value}
            data = merged(data, value)
    return data


def merged(data: Any, changes: Any, source: str = "settings", whole: str | None = None) -> Any:
    """Return `data` with `changes`: mappings are merged, other values, also lists, are replaced.

    A mapping with keys such as `0` changes entries of a list; `source` names the changes in errors.
    A mapping in which `changes` alter the key `whole`, such as a plugin's name, is replaced.
    """

    def changed(value: Any, change: Any) -> Any:
        return change if _is_empty(change) else merged(value, change, source, whole)

    if not isinstance(changes, Mapping):
        return changes
    if isinstance(data, list):
        entries = list(data)
        for key, value in changes.items():
            index = index_in(entries, key, source)
            entries[index] = changed(entries[index], value)
        return entries
    if not isinstance(data, Mapping) or (whole in changes and changes[whole] != data.get(whole)):
        return changes
    return {**data, **{key: changed(data.get(key), value) for key, value in changes.items()}}


def _is_empty(changes: Any) -> bool:
    return isinstance(changes, Mapping) and not changes


def index_in(entries: Sequence[object], key: object, source: str) -> int:
    """Return the index in a list that a key such as `0` denotes; `source` is for errors."""
    if str(key).isdecimal() and int(str(key)) < len(entries):
        return int(str(key))
    raise KinfeasError(f"{source}: unknown index {key!r} of a list of {len(entries)} entries")


def to_options(settings: Settings) -> list[str]:
    """Return the words of a command line that make these settings."""
    pairs = [("--set", f"{key}={json.dumps(value)}") for key, value in settings.items()]
    return [word for pair in pairs for word in pair]


@cache
def _adapter(kind: Any) -> "TypeAdapter[Any]":
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    # Pydantic accepts a config for standard types only, and passes it on to dataclasses in them.
    return TypeAdapter(tuple[kind], config=strict)


def validated(kind: Any, data: Any, source: str, key: str = "", changes: Any = None) -> Any:
    """Return plain data, which may contain arrays and tuples, as an instance of the type `kind`.

    Raises:
        KinfeasError: If the data are invalid. The error names the path of a key, which begins with
            `key`, and the source, or the settings if the invalid value is one of their `changes`.
    """
    from pydantic import ValidationError
    from pydantic_core import PydanticSerializationError, to_json

    try:
        # In JSON, strict mode accepts a list for a tuple.
        content = to_json((data,), inf_nan_mode="constants", fallback=_of_numpy)
        return _adapter(kind).validate_json(content)[0]
    except ValidationError as error:
        problems = error.errors(include_url=False)
    except PydanticSerializationError as error:  # text that is no valid UTF-8, or an object
        named = f"{source}: {key!r}" if key else source
        raise KinfeasError(f"{named}: {error}") from error
    # An unknown key before others: a misspelt key is often reported as missing, too.
    first = next((problem for problem in problems if problem["type"] == _UNKNOWN), problems[0])
    keys = _keys(first["loc"], data)
    # Join the messages on one value: of each type of a union, and of the last missing list entry.
    same = [problem for problem in problems if _keys(problem["loc"], data) == keys]
    missing = [problem for problem in same if problem["type"] == "missing"]
    same = [problem for problem in same if problem not in missing[:-1]]
    text = " or ".join(dict.fromkeys(map(_rule, same)))
    if first["type"] == _UNKNOWN:
        text = f"unknown key{no_such(keys[-1], _fields(kind, keys[:-1]))}"
    elif first["type"] == "missing" and isinstance(first["loc"][-1], str):
        keys = [*keys, str(first["loc"][-1])]
    elif first["type"] != "value_error":
        text = f"{text}, not {reprlib.repr(first['input'])}"
    if changes is not None and _has(changes, keys):
        source = "settings"
    path = ".".join([key, *keys] if key else keys)
    raise KinfeasError(f"{source}: {path!r}: {text}" if path else f"{source}: {text}")


_UNKNOWN = "unexpected_keyword_argument"


def _rule(problem: "ErrorDetails") -> str:
    """Return the requirement that an error of pydantic states."""
    if problem["type"] == "missing" and isinstance(index := problem["loc"][-1], int):
        return f"must be a list of {index + 1} entries"
    if problem["type"] == "too_long":
        return f"must be a list of at most {problem['ctx']['max_length']} entries"
    if problem["type"] == "too_short":
        return f"must be a list of {problem['ctx']['min_length']} or more entries"
    return problem["msg"].removeprefix("Value error, ")


def _of_numpy(value: Any) -> object:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise ValueError(f"{value!r} is no value of a setting")


def _keys(location: Sequence[int | str], data: Any) -> list[str]:
    """Return the keys that lead to an error, without the types of unions that pydantic names."""
    keys: list[str] = []
    for key in location[1:]:
        indices = range(len(data)) if isinstance(data, list | tuple) else ()
        if key in (data if isinstance(data, Mapping) else indices):
            keys, data = [*keys, str(key)], data[key]
    return keys


def _has(changes: Any, keys: Sequence[str]) -> bool:
    """Return whether settings change the value at a path of keys."""
    for key in keys:
        if not isinstance(changes, Mapping):
            return True
        if key not in changes:
            return False
        changes = changes[key]
    return not _is_empty(changes)


def _fields(kind: Any, keys: Sequence[str]) -> list[str]:
    """Return the names of the fields of the dataclass at the path `keys`."""
    classes = _dataclasses(kind)
    for key in keys:
        hints = [get_type_hints(cls).get(key) for cls in classes]
        # Indices of lists and keys of mappings lead to no other dataclass.
        classes = [inner for hint in hints for inner in _dataclasses(hint)] or classes
    return [entry.name for cls in classes for entry in fields(cls) if entry.init]


def _dataclasses(kind: Any) -> list[Any]:
    if is_dataclass(kind):
        return [kind]
    return [cls for inner in get_args(kind) for cls in _dataclasses(inner)]
