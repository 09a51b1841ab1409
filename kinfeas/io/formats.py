"""Readers of CSV and JSON files."""

import csv
import json
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.files import read_file, reading

MAX_JSON_BYTES = 1_000_000


def read_csv(
    path: Path, columns: Sequence[str], optional: Collection[str] = ()
) -> dict[str, Array]:
    """Return columns of a CSV file by name, NaN where a row has no entry.

    The `optional` ones may be missing, others are ignored.

    Raises:
        KinfeasError: If the file cannot be read, a column is missing or an entry is no number.
    """
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True, strict=True)
            rows, names = list(table), table.fieldnames or ()
    except csv.Error as error:
        raise KinfeasError(f"{path}: is no CSV file: {error}") from error
    table_columns = {}
    for name in columns:
        if name in names:
            table_columns[name] = np.empty(len(rows))
            for i, row in enumerate(rows):
                try:
                    table_columns[name][i] = float(row[name] or "nan")
                except ValueError as error:
                    raise KinfeasError(f"{path}, row {i + 1}, {name}: {error}") from error
        elif name not in optional:
            raise KinfeasError(f"{path}: column {name!r} is missing")
    return table_columns


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
