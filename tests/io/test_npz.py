import io
import zipfile

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io import npz
from kinfeas.io.npz import read_npz

NAMES = ("time", "ee_pose")


def member(value):
    file = io.BytesIO()
    np.save(file, value)
    return file.getvalue()


def header(shape):
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(80)


def write(path, content, **options):
    with zipfile.ZipFile(path, "w", **options) as archive:
        archive.writestr("time.npy", content)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_reads_what_numpy_writes_and_leaves_the_rest(tmp_path, save):
    save(tmp_path / "a.npz", time=np.arange(3.0), other=np.array([None]))
    found = read_npz(tmp_path / "a.npz", NAMES)
    assert found.keys() == {"time"}
    np.testing.assert_array_equal(found["time"], [0.0, 1.0, 2.0])


def patched(content, at, value):
    """Return an archive with two bytes changed in the heads of its only member, both of them."""
    for mark, offset in ((b"PK\x03\x04", at), (b"PK\x01\x02", at + 2)):
        start = content.rindex(mark) + offset
        content = content[:start] + value.to_bytes(2, "little") + content[start + 2 :]
    return content


ENCRYPTED, METHOD = (6, 1), (8, 99)


@pytest.mark.parametrize(("at", "value"), [ENCRYPTED, METHOD])
def test_archives_that_cannot_be_unpacked_are_refused(tmp_path, at, value):
    path = write(tmp_path / "a.npz", member(np.arange(3.0)))
    path.write_bytes(patched(path.read_bytes(), at, value))
    with pytest.raises(KinfeasError, match=r"no NPZ file of plain arrays: .*(encrypted|method)"):
        read_npz(path, NAMES)


@pytest.mark.parametrize(
    "content",
    [
        b"hello",
        member(np.array([None])),
        header("(1000000000000,)"),
        header(f"({10**30},)"),
        header("(True,)"),
        header("(5,"),
        header("(-1,)"),
    ],
)
def test_members_that_are_no_plain_arrays_are_refused(tmp_path, content):
    with pytest.raises(KinfeasError, match=r"a\.npz: is no NPZ file of plain arrays"):
        read_npz(write(tmp_path / "a.npz", content), NAMES)


def test_archives_that_unpack_to_too_much_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(npz, "MAX_BYTES", 1000)
    path = write(tmp_path / "a.npz", member(np.zeros(1000)), compression=zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 1000
    with pytest.raises(KinfeasError, match="must unpack to at most 1,000 bytes"):
        read_npz(path, NAMES)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_broken_packings_are_refused(tmp_path, method):
    path = write(tmp_path / "a.npz", member(np.zeros(100)), compression=method)
    content = bytearray(path.read_bytes())
    content[60:80] = b"\xff" * 20
    path.write_bytes(bytes(content))
    with pytest.raises(KinfeasError, match=r"a\.npz: "):
        read_npz(path, NAMES)
