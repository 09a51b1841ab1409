"""Arrays from NPZ archives that may come from anywhere: nothing is unpickled, memory is bounded."""

import zipfile
import zlib
from collections.abc import Sequence
from lzma import LZMAError
from pathlib import Path
from tokenize import TokenError
from typing import Any

from numpy.lib import format as npy
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import reading

MAX_BYTES = 200_000_000
"""More than a demonstration of an hour at 300 Hz unpacks to."""

# What an archive raises that is cut, encrypted, packed in an unknown way or no archive at all.
_BROKEN = (
    ArithmeticError,
    EOFError,
    LZMAError,
    MemoryError,
    RuntimeError,
    TokenError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return those of the arrays `names` that an archive holds, by name.

    Raises:
        KinfeasError: If it cannot be read, is broken, holds Python objects or unpacks to more than
            `MAX_BYTES`.
    """
    try:
        with reading(path), zipfile.ZipFile(path) as archive:
            return _arrays(archive, path, names)
    except KinfeasError:
        raise
    except _BROKEN as error:
        raise KinfeasError(f"{path}: is no NPZ file of plain arrays: {error}") from error


def _arrays(archive: zipfile.ZipFile, path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    sizes = {info.filename: info.file_size for info in archive.infolist()}
    held = [name for name in names if f"{name}.npy" in sizes]
    if sum(sizes[f"{name}.npy"] for name in held) > MAX_BYTES:
        raise KinfeasError(f"{path}: must unpack to at most {MAX_BYTES:,} bytes")
    arrays = {}
    for name in held:
        # Of a header that promises too much only as many bytes are read as there are.
        with archive.open(f"{name}.npy") as file:
            arrays[name] = npy.read_array(file, allow_pickle=False)
    return arrays
