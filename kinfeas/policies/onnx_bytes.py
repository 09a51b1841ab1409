"""What stands in an ONNX file, read with nothing but the standard library.

An ONNX file is a protocol buffer. Reading it here rather than with `onnx` spares a robot that
library, and lets nothing reach onnxruntime that was not looked at: a field that is not asked for by
name is refused. The numbers of the fields are those of `onnx.proto`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from kinfeas.core.errors import KinfeasError

Fields = dict[str, list[int | bytes]]

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


@dataclass(frozen=True)
class Entry:
    """One field of a message.

    Attributes:
        number: Which field it is.
        value: A whole number, or bytes.
        raw: The bytes that it takes, its number included.
    """

    number: int
    value: int | bytes
    raw: bytes


def entries(message: bytes) -> Iterator[Entry]:
    """Yield the fields of a message in their order.

    Raises:
        KinfeasError: If the bytes are no message, or end too early.
    """
    at = 0
    while at < len(message):
        start = at
        key, at = _varint(message, at)
        kind, value = key & 7, 0
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield Entry(key >> 3, value, message[start:at])
            continue
        if kind == _BYTES:
            size, at = _varint(message, at)
        elif kind in (_FIXED32, _FIXED64):
            size = 4 if kind == _FIXED32 else 8
        else:
            raise KinfeasError("not an ONNX file")
        if key >> 3 == 0:
            raise KinfeasError("not an ONNX file")
        if size > len(message) - at:
            raise KinfeasError("truncated, or not an ONNX file")
        at += size
        yield Entry(key >> 3, message[at - size : at], message[start:at])


def fields(message: bytes, names: Mapping[int, str], what: str) -> Fields:
    """Return the values of a message's fields by name; those that are absent have none.

    Args:
        message: The bytes.
        names: The fields that it may have.
        what: What it is, for the error.

    Raises:
        KinfeasError: If it has another field, or is broken.
    """
    found: Fields = {name: [] for name in names.values()}
    for entry in entries(message):
        if entry.number not in names:
            other = _FORBIDDEN.get((what, entry.number), f"the field {entry.number}")
            raise KinfeasError(f"its {what} has {other}, which a policy file must not have")
        found[names[entry.number]].append(entry.value)
    return found


def text(values: list[int | bytes], what: str) -> str:
    """Return the one string of a field, empty if it is absent.

    Raises:
        KinfeasError: If there are several, or it is none.
    """
    value = _one(values, b"", what)
    try:
        if isinstance(value, bytes):
            return value.decode()
    except UnicodeDecodeError:
        pass
    raise KinfeasError(f"broken ONNX file: {what} is no text")


def number(values: list[int | bytes], what: str) -> int:
    """Return the one whole number of a field, 0 if it is absent.

    Raises:
        KinfeasError: If there are several, or it is none.
    """
    value = _one(values, 0, what)
    if isinstance(value, int):
        return value
    raise KinfeasError(f"broken ONNX file: {what} is no whole number")


def content(values: list[int | bytes], what: str) -> bytes:
    """Return the one block of bytes of a field, empty if it is absent.

    Raises:
        KinfeasError: If there are several, or it is none.
    """
    value = _one(values, b"", what)
    if isinstance(value, bytes):
        return value
    raise KinfeasError(f"broken ONNX file: {what} is no block of bytes")


def messages(values: list[int | bytes], what: str) -> list[bytes]:
    """Return the blocks of bytes of a field that may stand several times.

    Raises:
        KinfeasError: If one is none.
    """
    return [content([value], what) for value in values]


# What a file could smuggle in is called by its name.
_FORBIDDEN = {
    ("model", 20): "training information",
    ("model", 25): "functions of its own",
    ("graph", 15): "sparse weights",
    ("node", 5): "attributes",
    ("tensor", 13): "external data: weights in another file",
    ("tensor", 14): "external data: weights in another file",
}


def _one(values: list[int | bytes], absent: int | bytes, what: str) -> int | bytes:
    # Where a single field stands several times, readers differ in which of them counts.
    if len(values) > 1:
        raise KinfeasError(f"broken ONNX file: {what} stands there {len(values)} times")
    return values[0] if values else absent


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """Return the whole number at `at`, seven bits a byte, and where the next thing begins."""
    value = 0
    for shift in range(0, 64, 7):
        if at >= len(message):
            raise KinfeasError("truncated, or not an ONNX file")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise KinfeasError("not an ONNX file")
