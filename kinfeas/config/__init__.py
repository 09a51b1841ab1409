"""Configuration: YAML files and `KEY=VALUE` assignments as frozen dataclasses, and back.

A dataclass is the schema. Pydantic validates its fields in strict mode: unknown keys, values of
another type, NaN and infinity raise an error with the path of the key. `quantities` has numbers
with bounds. A dataclass checks relations of its fields in `__post_init__` and raises ValueError.
"""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args, get_type_hints

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError, no_such

if TYPE_CHECKING:  # takes 0.1 s to import
    from pydantic import TypeAdapter, ValidationError

T = TypeVar("T")


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
        """Return the plugin of plain data; ValueError without a name or for other parameters."""
        entry = {"name": data} if isinstance(data, str) else data
        if not isinstance(entry, Mapping) or not isinstance(entry.get("name"), str):
            raise ValueError("must be a name, or a mapping with the key 'name'")
        flat = {key: value for key, value in entry.items() if key not in ("name", "parameters")}
        below = entry.get("parameters", {})
        if not isinstance(below, Mapping):
            raise ValueError("'parameters' must be a mapping")
        return cls(entry["name"], {**below, **flat})

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> Any:
        """Return the schema by which pydantic reads the short forms."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(cls.read)


def load(cls: type[T], path: Path, overrides: Sequence[str] = ()) -> T:
    """Return a YAML file as an instance of the dataclass `cls`; arguments as in `from_mapping`."""
    return from_mapping(cls, strict_yaml.read(path), str(path), overrides)


def from_mapping(cls: type[T], data: object, source: str, overrides: Sequence[str] = ()) -> T:
    """Return plain data as an instance of the dataclass `cls`.

    Args:
        cls: Frozen dataclass.
        data: Mapping of field names to plain values, complete without the `overrides`.
        source: File name for errors.
        overrides: Assignments `a.b=c`, applied in their order; `c` is YAML, and `a.0=c` changes
            the first entry of a list.

    Raises:
        KinfeasError: If a key is unknown or missing, or a value has a wrong type or range.
    """
    config: T = _validated(cls, data, source)
    if overrides:
        changed = to_mapping(config)
        for text in overrides:
            _assign(changed, text)
        config = _validated(cls, changed, source, overrides=overrides)
    return config


def convert(kind: Any, value: object, source: str, key: str) -> Any:
    """Return the plain value of a key as an instance of the type `kind`.

    Values that no YAML file can hold, and types that pydantic cannot validate, are passed through.
    """
    from pydantic import PydanticUndefinedAnnotation, PydanticUserError

    if not isinstance(value, str | bool | int | float | list | dict | None):
        return value
    try:
        return _validated(kind, value, source, key)
    except (PydanticUserError, PydanticUndefinedAnnotation):
        return value


def to_mapping(config: object) -> dict[str, Any]:
    """Return a dataclass as plain data that `from_mapping` reads back."""
    from pydantic_core import to_jsonable_python

    return cast("dict[str, Any]", to_jsonable_python(config))


def dump(config: object, path: Path) -> None:
    """Write a dataclass as a YAML file that `load` reads back."""
    strict_yaml.write(to_mapping(config), path)


def assigned(overrides: Sequence[str]) -> dict[str, object]:
    """Return assignments `a.b=c`, in which `c` is YAML, as nested mappings."""
    data: dict[str, object] = {}
    for text in overrides:
        _assign(data, text)
    return data


def index_in(entries: Sequence[object], key: object, source: str) -> int:
    """Return the index in a list that a key such as `0` names."""
    if str(key).isdecimal() and int(str(key)) < len(entries):
        return int(str(key))
    raise KinfeasError(f"{source}: unknown index {key!r} of a list of {len(entries)} entries")


def _key(text: str) -> str:
    return text.partition("=")[0].strip()


def _assign(data: Any, text: str) -> None:
    """Change the nested mappings and lists `data` as the assignment `text` describes."""
    *above, last = _key(text).split(".")
    if "=" not in text or not all([*above, last]):
        raise KinfeasError(f"{text}: must have the form key=value or key.inner=value")
    value = strict_yaml.parse(text.partition("=")[2], text)
    for key in above:
        if isinstance(data, list):
            data = data[index_in(data, key, text)]
        elif isinstance(data, dict):
            if data.get(key) is None:
                data[key] = {}
            data = data[key]
    if isinstance(data, list):
        data[index_in(data, last, text)] = value
    elif isinstance(data, dict):
        data[last] = value
    else:
        raise KinfeasError(f"{text}: unknown key {_key(text)!r}: {data!r} has no keys")


_WORDS = {
    "Input should ": "must ",
    "Value error, ": "",
    "a valid array": "a list",
    "an object": "a mapping of keys to values",
}
"""Words of pydantic's messages and ours."""


@cache
def _adapter(kind: Any) -> "TypeAdapter[Any]":
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    # Pydantic takes a config for standard types only, and hands it on to the dataclasses within.
    return TypeAdapter(tuple[kind], config=strict)


def _validated(
    kind: Any, data: object, source: str, key: str = "", overrides: Sequence[str] = ()
) -> Any:
    from pydantic import ValidationError
    from pydantic_core import PydanticSerializationError, to_json

    try:
        # Read as JSON, a list may fill a tuple in strict mode.
        return _adapter(kind).validate_json(to_json((data,), inf_nan_mode="constants"))[0]
    except ValidationError as error:
        key, message = _explained(error, kind, data, key)
    except PydanticSerializationError as error:  # text that is no valid UTF-8
        message = str(error)
    within = [text for text in overrides if f"{key}.".startswith(f"{_key(text)}.")]
    beyond = [text for text in overrides if _key(text).startswith(f"{key}." if key else "")]
    raise KinfeasError(f"{', '.join(within or beyond) or source}: {message}")


def _explained(error: "ValidationError", kind: Any, data: object, above: str) -> tuple[str, str]:
    """Return the path of the first wrong key, below the key `above`, and the fault."""
    unknown = "unexpected_keyword_argument"
    # A misspelt key is often a missing one as well.
    errors = sorted(error.errors(include_url=False), key=lambda one: one["type"] != unknown)
    keys, first = _path(errors[0], data), errors[0]
    key = ".".join([above, *keys] if above else keys)
    if first["type"] == unknown:
        return key, f"unknown key {key!r}{no_such(keys[-1], _fields(kind, keys[:-1]))}"
    if first["type"] == "missing" and isinstance(first["loc"][-1], int):
        return key, f"{key!r} has too few entries: {reprlib.repr(first['input'])}"
    if first["type"] == "missing":
        key = f"{key}.{first['loc'][-1]}" if key else str(first["loc"][-1])
        return key, f"the key {key!r} is missing"
    # A union has an error for each of its types.
    messages = {one["msg"]: None for one in errors if _path(one, data) == keys}
    text = " or ".join(messages)
    for pydantics, ours in _WORDS.items():
        text = text.replace(pydantics, ours)
    name = f"{key!r}: " if key and first["type"] == "value_error" else f"{key!r} " if key else ""
    if first["type"] != "value_error":
        text += f", not {reprlib.repr(first['input'])}"
    return key, name + text


def _path(error: Any, data: Any) -> list[str]:
    """Return the keys that lead to an error; pydantic also names the types within a union."""
    keys: list[str] = []
    for key in error["loc"][1:]:
        indices = range(len(data)) if isinstance(data, list | tuple) else ()
        if key in (data if isinstance(data, Mapping) else indices):
            keys, data = [*keys, str(key)], data[key]
    return keys


def _fields(kind: Any, keys: Sequence[str]) -> list[str]:
    """Return the names of the fields of the dataclass that `keys` lead to."""
    found = _dataclasses(kind)
    for key in keys:
        hints = [hint for cls in found for name, hint in get_type_hints(cls).items() if name == key]
        # Indices of lists and keys of mappings lead to no other dataclass.
        found = [inner for hint in hints for inner in _dataclasses(hint)] or found
    return [entry.name for cls in found for entry in fields(cls) if entry.init]


def _dataclasses(kind: Any) -> list[Any]:
    if is_dataclass(kind):
        return [kind]
    return [found for inner in get_args(kind) for found in _dataclasses(inner)]
