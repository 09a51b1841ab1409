import io
import zipfile

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io import formats
from kinfeas.io.formats import read_csv, read_json, read_npz


def table(folder, text):
    path = folder / "table.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    return path


def test_csv_columns_are_chosen_by_name(tmp_path):
    path = table(tmp_path, "a, note ,b\n1,x,2\n\n3,y,4.5\n")
    found = read_csv(path, lambda names: [name for name in ("b", "a") if name in names])
    assert found.values.tolist() == [[2.0, 1.0], [4.5, 3.0]]
    assert found.place("b", 1) == f"{path}, line 4, b"
    assert read_csv(table(tmp_path, "a,b\n"), lambda names: names).values.shape == (0, 2)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "line 1: column 'a'"),
        ("a,a\n1,2\n", "line 1: column 'a'"),
        ("a,b\n1\n", "line 2: "),
        ("a,b\n1,2\nfar,2\n", "line 3, a: "),
    ],
)
def test_csv_errors_name_line_and_column(tmp_path, text, place):
    path = table(tmp_path, text)
    with pytest.raises(KinfeasError, match=f"^{path}, {place}"):
        read_csv(path, lambda _: ["a"])


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


NAMES = ("time", "ee_pose")


def member(value):
    file = io.BytesIO()
    np.save(file, value)
    return file.getvalue()


def header(shape):
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(80)


def archive(path, content, **options):
    with zipfile.ZipFile(path, "w", **options) as file:
        file.writestr("time.npy", content)
    return path


def test_npz_arrays_are_read_by_name(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", time=np.arange(3.0), other=np.array([None]))
    found = read_npz(tmp_path / "a.npz", NAMES)
    assert found.keys() == {"time"}
    np.testing.assert_array_equal(found["time"], [0.0, 1.0, 2.0])


@pytest.mark.parametrize(
    "content",
    [b"hello", member(np.array([None])), *map(header, ("(1000000000000,)", f"({10**30},)", "(5,"))],
)
def test_npz_members_that_are_no_plain_arrays(tmp_path, content):
    with pytest.raises(KinfeasError, match=r"a\.npz: "):
        read_npz(archive(tmp_path / "a.npz", content), NAMES)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, zipfile.ZIP_STORED])
def test_broken_npz_archives(tmp_path, method):
    path = archive(tmp_path / "a.npz", member(np.zeros(100)), compression=method)
    whole = path.read_bytes()
    for content in (whole[:60] + b"\xff" * 20 + whole[80:], whole[:50], b"", member(np.zeros(3))):
        path.write_bytes(content)
        with pytest.raises(KinfeasError, match=r"a\.npz: "):
            read_npz(path, NAMES)


def test_npz_archives_that_unpack_to_too_much(tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "MAX_NPZ_BYTES", 1000)
    path = archive(tmp_path / "a.npz", member(np.zeros(1000)), compression=zipfile.ZIP_DEFLATED)
    with pytest.raises(KinfeasError, match="1,000 bytes"):
        read_npz(path, NAMES)
