"""Columns of numbers from CSV files with a header."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.files import reading


@dataclass(frozen=True)
class CsvTable:
    """Some columns of a CSV file, and where its rows stand.

    Attributes:
        source: The file.
        values: Numbers, shape (rows, columns).
        lines: Number of each row's line.
    """

    source: Path
    values: Array
    lines: tuple[int, ...]

    def place(self, name: str, row: int) -> str:
        """Return the words that say where the entry `name` of a row stands."""
        return f"{self.source}, line {self.lines[row]}, {name}"


def read_csv(path: Path, choose: Callable[[Sequence[str]], Sequence[str]]) -> CsvTable:
    """Return the columns of a CSV file that `choose` picks, in its order.

    Args:
        path: File whose first line names its columns; others than the chosen may hold anything.
        choose: From the names in the file to those that are wanted.

    Raises:
        KinfeasError: If the file cannot be read, a column is missing or there twice, or an entry is
            not a number.
    """
    lines, rows = [], []
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.reader(file, strict=True)
            header = [name.strip() for name in next(table, [])]
            for row in filter(None, table):
                lines.append(table.line_num)
                rows.append(row)
    except csv.Error as error:
        raise KinfeasError(f"{path}: is no CSV file: {error}") from error
    wanted = choose(header)
    for name in wanted:
        if header.count(name) != 1:
            problem = "repeated" if name in header else "missing"
            raise KinfeasError(f"{path}, line 1: column {name!r} is {problem}")
    places = (f"{path}, line {line}" for line in lines)
    samples = [_numbers(row, header, wanted, at) for row, at in zip(rows, places, strict=True)]
    values = np.array(samples, dtype=np.float64).reshape(-1, len(wanted))
    return CsvTable(path, values, tuple(lines))


def _numbers(
    row: Sequence[str], header: Sequence[str], wanted: Sequence[str], place: str
) -> list[float]:
    if len(row) != len(header):
        raise KinfeasError(f"{place}: has {len(row)} entries for {len(header)} columns")
    entries = dict(zip(header, row, strict=True))
    numbers = []
    for name in wanted:
        try:
            numbers.append(float(entries[name]))
        except ValueError as error:
            raise KinfeasError(f"{place}, {name}: {entries[name]!r} is not a number") from error
    return numbers
