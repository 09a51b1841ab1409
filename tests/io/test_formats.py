import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.formats import read_csv, read_json


def table(folder, text):
    path = folder / "table.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    return path


def test_csv_columns_are_read_by_name(tmp_path):
    path = table(tmp_path, "a, note ,b\n1,x,2\n\n3,y,4.5\n")
    found = read_csv(path, ("b", "a", "time"), ("time",))
    assert {name: values.tolist() for name, values in found.items()} == {
        "b": [2.0, 4.5],
        "a": [1.0, 3.0],
    }
    assert read_csv(table(tmp_path, "a,b\n"), ["a"])["a"].shape == (0,)


@pytest.mark.parametrize(
    ("text", "place"),
    [("", ": column 'a'"), ("a\n1\nx", ", row 2, a: ")],
)
def test_csv_errors_name_row_and_column(tmp_path, text, place):
    path = table(tmp_path, text)
    with pytest.raises(KinfeasError, match=f"^{path}{place}"):
        read_csv(path, ["a"])


@pytest.mark.parametrize(
    "content",
    [
        b"{}x",
        b"[]",
        b"[" * 200_000,
        b"\xff",
        b"{" + b" " * 1_000_000 + b"}",
    ],
)
def test_files_that_are_no_json_mapping(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(KinfeasError, match=f"^{path}: "):
        read_json(path)
