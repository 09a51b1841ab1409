"""Columns are found by name, and what is wrong is named with its line."""

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.csv_table import read_csv


def write(folder, text):
    path = folder / "table.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    return path


def test_returns_the_chosen_columns_in_order(tmp_path):
    path = write(tmp_path, "a, note ,b\n1,x,2\n\n3,y,4.5\n")
    table = read_csv(path, lambda names: [name for name in ("b", "a") if name in names])
    assert table.values.tolist() == [[2.0, 1.0], [4.5, 3.0]]
    assert table.place("b", 1) == f"{path}, line 4, b"


def test_a_table_without_rows_has_columns_too(tmp_path):
    assert read_csv(write(tmp_path, "a,b\n"), lambda names: names).values.shape == (0, 2)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "line 1: column 'a' is missing"),
        ("b\n1\n", "line 1: column 'a' is missing"),
        ("a,a\n1,2\n", "line 1: column 'a' is repeated"),
        ("a,b\n1\n", "line 2: has 1 entries for 2 columns"),
        ("a,b\n1,2\nfar,2\n", "line 3, a: 'far' is not a number"),
    ],
)
def test_names_what_is_wrong(tmp_path, text, problem):
    path = write(tmp_path, text)
    with pytest.raises(KinfeasError) as caught:
        read_csv(path, lambda _: ["a"])
    assert str(caught.value) == f"{path}, {problem}"


def test_what_cannot_be_read_as_csv_is_named(tmp_path):
    with pytest.raises(KinfeasError, match=r"none\.csv: cannot be read: No such file"):
        read_csv(tmp_path / "none.csv", lambda names: names)
    with pytest.raises(KinfeasError, match=r"\.csv: is no CSV file: unexpected end of data"):
        read_csv(write(tmp_path, 'a\n"1'), lambda names: names)
