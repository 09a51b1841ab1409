import pytest

from kinfeas.errors import KinfeasError
from kinfeas.files import read_file, reading, write_file


def test_a_file_is_replaced_or_stays_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "file"
    for content in (b"1", b"22"):
        write_file(path, content)
        assert path.read_bytes() == content
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    for wrong in (tmp_path / "folder", tmp_path / "none" / "file", path / "file"):
        with pytest.raises(KinfeasError, match="cannot be written"):
            write_file(wrong, b"333")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["file", "folder"]
    assert path.read_bytes() == b"22"


def test_reads_up_to_a_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"1234")
    assert read_file(tmp_path / "file", 4) == b"1234"
    with pytest.raises(KinfeasError, match="file: too large, at most 3 bytes are allowed"):
        read_file(tmp_path / "file", 3)


def test_what_cannot_be_read_is_named(tmp_path):
    for wrong, why in (("none", "No such file"), (".", "Is a directory")):
        with pytest.raises(KinfeasError, match=f"cannot be read: {why}"):
            read_file(tmp_path / wrong, 9)
    with pytest.raises(KinfeasError, match="odd: not a text file in UTF-8"), reading("odd"):
        b"\xff".decode()
