"""What a frozen dataclass says about the plain data that may fill it.

Its fields may be `str`, `bool`, `int`, `float`, `Path`, `Literal`, `X | None` and other unions,
`tuple[X, ...]`, `tuple[X, Y]`, `dict[str, X]`, dataclasses and `object` (passed through);
`Annotated[float, Interval(low=0.0)]` bounds a number. A dataclass checks what involves two fields
in `__post_init__` and raises ValueError.
"""

import difflib
import reprlib
import sys
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from kinfeas.core.errors import KinfeasError


@dataclass(frozen=True)
class Interval:
    """The numbers from `low` to `high`, ends included unless open; bounds an annotated number."""

    low: float = -sys.float_info.max
    high: float = sys.float_info.max
    open_low: bool = False
    open_high: bool = False

    def __contains__(self, value: float) -> bool:
        """Return whether `value` lies within; NaN lies in no interval."""
        above = self.low < value if self.open_low else self.low <= value
        below = value < self.high if self.open_high else value <= self.high
        return above and below

    def __str__(self) -> str:
        """Return the words that follow "a number": `> 0`, `<= 1` or `in (0, 1]`."""
        everything = Interval()
        if self.high == everything.high:
            return f"{'>' if self.open_low else '>='} {_digits(self.low)}"
        if self.low == everything.low:
            return f"{'<' if self.open_high else '<='} {_digits(self.high)}"
        ends = "(" if self.open_low else "[", ")" if self.open_high else "]"
        return f"in {ends[0]}{_digits(self.low)}, {_digits(self.high)}{ends[1]}"


def _digits(number: float) -> str:
    """Return a number with no more digits than one reads, a million and its like in full."""
    return f"{number:.0f}" if 1e6 <= abs(number) < 1e12 else f"{number:g}"


@dataclass(frozen=True)
class Place:
    """Where in the data a value stands, so that an error can say it."""

    source: str
    key: str = ""
    overrides: Mapping[str, str] = field(default_factory=dict)

    def inner(self, key: object) -> "Place":
        """Return the place of the entry `key` of the value here."""
        return replace(self, key=f"{self.key}.{key}" if self.key else str(key))

    def error(self, message: str) -> KinfeasError:
        """Return an error that begins with the file or the override that is to blame."""
        return KinfeasError(f"{self._origin()}: {message}")

    def wrong(self, value: object, allowed: str) -> KinfeasError:
        """Return the error on a `value` that is not what is `allowed` here."""
        name = f"{self.key!r} " if self.key else ""
        return self.error(f"{name}must be {allowed}, not {reprlib.repr(value)}")

    def was_begun(self, value: object) -> bool:
        """Return whether overrides alone put the keys of the mapping `value` here, one by one."""
        if not isinstance(value, Mapping):
            return False
        keys = [f"{self.inner(key).key}." for key in value]
        return bool(keys) and all(
            any(f"{one}.".startswith(key) for one in self.overrides) for key in keys
        )

    def _origin(self) -> str:
        key = f"{self.key}."
        for assigned, text in self.overrides.items():
            if key.startswith(f"{assigned}.") or (self.key and f"{assigned}.".startswith(key)):
                return text
        # What is wrong with all of it together may be the fault of any of them.
        return self.source if self.key else " with ".join([self.source, *self.overrides.values()])


def convert_dataclass(cls: Any, value: object, place: Place) -> Any:
    """Return the mapping `value` as an instance of the dataclass `cls`.

    Raises:
        KinfeasError: If a key is unknown or missing, or a value has a wrong type or range.
    """
    mapping, known = _string_keys(value, place), init_fields(cls)
    names = [entry.name for entry in known]
    for key in mapping:
        if key not in names:
            at = place.inner(key)
            raise at.error(f"unknown key {at.key!r}{no_such(key, names)}")
    kinds, values = get_type_hints(cls, include_extras=True), {}
    for entry in known:
        at = place.inner(entry.name)
        if entry.name in mapping:
            values[entry.name] = _convert(kinds[entry.name], mapping[entry.name], at)
        elif default(entry) is MISSING:
            raise at.error(f"{at.key!r} is missing; it must be {_describe(kinds[entry.name])}")
    try:
        return cls(**values)
    except ValueError as error:
        raise place.error(f"{place.key!r}: {error}" if place.key else str(error)) from error


def convert(kind: Any, value: object, place: Place) -> Any:
    """Return plain data as the type `kind`.

    Other values, and those of types that no file can hold, come back as they are.

    Raises:
        KinfeasError: If `value` has a wrong type or range.
    """
    if isinstance(value, _PLAIN):
        with suppress(TypeError):
            return _convert(kind, value, place)
    return value


def init_fields(cls: Any) -> list[Field[Any]]:
    """Return the fields that the constructor of the dataclass `cls` takes."""
    return [entry for entry in fields(cls) if entry.init]


def default(entry: Field[Any]) -> Any:
    """Return the default of a dataclass field, or MISSING."""
    return entry.default if entry.default_factory is MISSING else entry.default_factory()


def no_such(word: str, names: Collection[str]) -> str:
    """Return the end of an error on the unknown `word`: a guess, and the `names` that exist."""
    close = difflib.get_close_matches(word, names, n=1)
    guess = f" (did you mean {close[0]!r}?)" if close else ""
    return f"{guess}; known are {', '.join(sorted(names)) or 'none'}"


def _convert(kind: Any, value: object, place: Place) -> Any:
    """Return `value` as the type `kind`."""
    if kind is object:
        return value
    if is_dataclass(kind):
        return convert_dataclass(kind, value, place)
    if kind in _SCALARS:
        return _convert_scalar(kind, value, place)
    converter = _CONVERTERS.get(get_origin(kind))
    if converter is None:
        raise TypeError(f"{place.key}: {kind} is not supported in a configuration")
    return converter(kind, value, place)


def _convert_scalar(kind: Any, value: object, place: Place) -> Any:
    if kind is Path and isinstance(value, str | Path):
        return Path(value)
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        # Within the largest floats lie neither NaN nor a whole number too large for a float.
        if value in Interval():
            return float(value)
    elif type(value) is kind:  # and not a subclass, because True is an int to Python
        return value
    raise place.wrong(value, _describe(kind))


def _convert_bounded(kind: Any, value: object, place: Place) -> Any:
    inner, *notes = get_args(kind)
    if inner not in (int, float):
        raise TypeError(f"{place.key}: only int and float can be annotated, not {inner}")
    # The words for what is allowed include the range even where the type is wrong.
    try:
        number = _convert(inner, value, place)
    except KinfeasError:
        raise place.wrong(value, _describe(kind)) from None
    if any(isinstance(note, Interval) and number not in note for note in notes):
        raise place.wrong(value, _describe(kind))
    return number


def _convert_union(kind: Any, value: object, place: Place) -> Any:
    options = get_args(kind)
    if value is None and NoneType in options:
        return None
    real = [option for option in options if option is not NoneType]
    if len(real) == 1 and is_dataclass(real[0]):
        return _convert(real[0], value, place)  # its error names the key within
    for option in real:
        try:
            return _convert(option, value, place)
        except KinfeasError:
            continue
    raise place.wrong(value, _describe(kind))


def _convert_literal(kind: Any, value: object, place: Place) -> Any:
    for option in get_args(kind):
        if type(option) is type(value) and option == value:
            return option
    raise place.wrong(value, _describe(kind))


def _convert_tuple(kind: Any, value: object, place: Place) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise place.wrong(value, _describe(kind))
    kinds = get_args(kind)
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise place.wrong(value, _describe(kind))
    entries = zip(kinds, value, strict=True)
    return tuple(_convert(inner, entry, place.inner(i)) for i, (inner, entry) in enumerate(entries))


def _convert_dict(kind: Any, value: object, place: Place) -> dict[str, Any]:
    key, inner = get_args(kind)
    if key is not str:
        raise TypeError(f"{place.key}: only strings can be keys, not {key}")
    mapping = _string_keys(value, place)
    _check_names(inner, mapping, place)
    return {key: _convert(inner, entry, place.inner(key)) for key, entry in mapping.items()}


def _check_names(kind: Any, mapping: Mapping[str, object], place: Place) -> None:
    """Raise if overrides change a part of an entry that is not there to be changed."""
    begun = [key for key, value in mapping.items() if place.inner(key).was_begun(value)]
    for key in begun if is_dataclass(kind) else ():
        at, given = place.inner(key), _string_keys(mapping[key], place)
        if any(default(one) is MISSING and one.name not in given for one in init_fields(kind)):
            known = no_such(key, [other for other in mapping if other not in begun])
            raise at.error(f"there is no {at.key!r}{known}")


def _string_keys(value: object, place: Place) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise place.wrong(value, "a mapping of keys to values")
    for key in value:
        if not isinstance(key, str):
            raise place.inner(key).error(f"the key {key!r} must be a string")
    return value


_CONVERTERS: dict[Any, Callable[[Any, object, Place], Any]] = {
    Annotated: _convert_bounded,
    Union: _convert_union,
    UnionType: _convert_union,
    Literal: _convert_literal,
    tuple: _convert_tuple,
    dict: _convert_dict,
}

_PLAIN = (str, bool, int, float, list, dict, NoneType)
"""What a YAML file is made of."""

_SCALARS: dict[Any, str] = {
    str: "a string",
    bool: "true or false",
    int: "a whole number",
    float: "a finite number",
    Path: "a path",
    NoneType: "null",
}


def _describe(kind: Any) -> str:
    """Return what values `kind` allows, to follow "must be"."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        word = "a whole number" if arguments[0] is int else "a number"
        return " ".join([word, *(str(note) for note in arguments[1:])])
    if origin is Literal:
        return "one of " + ", ".join(map(repr, arguments))
    if origin in (Union, UnionType):
        return " or ".join(map(_describe, arguments))
    if origin is tuple:
        inner = [entry for entry in arguments if entry is not Ellipsis]
        size = "" if Ellipsis in arguments else f"{len(inner)} entries, "
        return f"a list of {size}each {', '.join(dict.fromkeys(map(_describe, inner)))}"
    return _SCALARS.get(kind, "a mapping of keys to values")
