"""Readers of CSV, JSON and NPZ files with bounded memory; nothing is unpickled."""

import csv
import json
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from lzma import LZMAError
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.files import read_file, reading

MAX_JSON_BYTES, MAX_NPZ_BYTES = 1_000_000, 200_000_000
"""Largest JSON file, and largest size of the arrays of an NPZ archive."""

# Errors of broken, encrypted or foreign archives.
_BROKEN_NPZ = (
    ArithmeticError, EOFError, LZMAError, MemoryError, RuntimeError, TokenError, TypeError,
    ValueError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class CsvTable:
    """Numbers of a CSV file, shape (rows, columns), with the line of each row."""

    source: Path
    values: Array
    lines: tuple[int, ...]

    def place(self, name: str, row: int) -> str:
        """Return file, line and column of an entry, for errors."""
        return f"{self.source}, line {self.lines[row]}, {name}"


def read_csv(path: Path, choose: Callable[[Sequence[str]], Sequence[str]]) -> CsvTable:
    """Return the columns of a CSV file that `choose` selects from the names in its first line.

    Raises:
        KinfeasError: If the file cannot be read, a column is missing or repeated, or an entry is
            no number.
    """
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.reader(file, strict=True)
            header = [name.strip() for name in next(table, [])]
            rows = [(table.line_num, row) for row in table if row]
    except csv.Error as error:
        raise KinfeasError(f"{path}: is no CSV file: {error}") from error
    wanted = choose(header)
    for name in wanted:
        if header.count(name) != 1:
            problem = "repeated" if name in header else "missing"
            raise KinfeasError(f"{path}, line 1: column {name!r} is {problem}")
    columns = [header.index(name) for name in wanted]
    values = np.empty((len(rows), len(wanted)))
    for i, (line, row) in enumerate(rows):
        if len(row) != len(header):
            raise KinfeasError(
                f"{path}, line {line}: has {len(row)} entries for {len(header)} columns"
            )
        for k, column in enumerate(columns):
            try:
                values[i, k] = float(row[column])
            except ValueError as error:
                raise KinfeasError(f"{path}, line {line}, {wanted[k]}: {error}") from error
    return CsvTable(path, values, tuple(line for line, _ in rows))


def read_json(path: Path) -> dict[str, object]:
    """Return the mapping in a JSON file; numbers may be `Infinity` and `NaN`.

    Raises:
        KinfeasError: If the file cannot be read, is larger than 1 MB, or holds no mapping.
    """
    content = read_file(path, MAX_JSON_BYTES)
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise KinfeasError(f"{path}: broken JSON: {error}") from error
    if not isinstance(data, dict):
        raise KinfeasError(f"{path}: must hold a mapping of keys to values")
    return data


def read_npz(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return those of the arrays `names` that an NPZ archive holds.

    Raises:
        KinfeasError: If the file cannot be read, is broken, holds Python objects or unpacks to more
            than 200 MB.
    """
    try:
        with reading(path), zipfile.ZipFile(path) as archive:
            sizes = {info.filename: info.file_size for info in archive.infolist()}
            held = [name for name in names if f"{name}.npy" in sizes]
            if sum(sizes[f"{name}.npy"] for name in held) > MAX_NPZ_BYTES:
                raise KinfeasError(f"{path}: must unpack to at most {MAX_NPZ_BYTES:,} bytes")
            arrays = {}
            for name in held:
                with archive.open(f"{name}.npy") as file:
                    arrays[name] = npy.read_array(file, allow_pickle=False)
            return arrays
    except KinfeasError:
        raise
    except _BROKEN_NPZ as error:
        raise KinfeasError(f"{path}: is no NPZ file of plain arrays: {error}") from error
