"""Columns of numbers from CSV files with a header."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinfeas.errors import KinfeasError
from kinfeas.spatial import Array


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
        KinfeasError: If a column is missing or there twice, or an entry is not a number.
        OSError, UnicodeDecodeError, csv.Error: If the file cannot be read as CSV.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file, strict=True)
        header = [name.strip() for name in next(rows, [])]
        wanted = choose(header)
        for name in wanted:
            if header.count(name) != 1:
                problem = "repeated" if name in header else "missing"
                raise KinfeasError(f"{path}, line 1: column {name!r} is {problem}")
        lines, samples = [], []
        for row in filter(None, rows):
            lines.append(rows.line_num)
            samples.append(_numbers(row, header, wanted, f"{path}, line {rows.line_num}"))
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
