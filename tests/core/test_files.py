import os
import shutil
import stat
from pathlib import Path

import pytest

from kinfeas.core import files
from kinfeas.core.errors import KinfeasError


def test_a_file_is_replaced_or_stays_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "file"
    for content in (b"1", b"22"):
        files.write_file(path, content)
        assert path.read_bytes() == content
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    for wrong in (tmp_path / "folder", tmp_path / "none" / "file", path / "file"):
        with pytest.raises(KinfeasError, match=str(wrong)):
            files.write_file(wrong, b"333")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["file", "folder"]
    assert path.read_bytes() == b"22"


def test_reads_files_up_to_a_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"1234")
    assert files.read_file(tmp_path / "file", 4) == b"1234"
    os.mkfifo(tmp_path / "pipe")
    for wrong in ("none", ".", "pipe", "/dev/zero", "a\0.yaml", "\ud800.yaml"):
        with pytest.raises(KinfeasError) as caught:
            files.read_file(tmp_path / wrong, 9)
        assert str(caught.value).isprintable()
    with pytest.raises(KinfeasError, match="file"):
        files.read_file(tmp_path / "file", 3)
    with pytest.raises(KinfeasError, match="odd"), files.reading(Path("odd")):
        b"\xff".decode()


def test_a_file_that_is_not_finished_changes_nothing(tmp_path):
    path = tmp_path / "film.gif"
    path.write_bytes(b"old")
    with pytest.raises(KinfeasError, match=r"film\.gif.*full"), files.replacing(path) as new:
        assert new.name == path.name
        new.write_bytes(b"ne")
        raise OSError(28, "full")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


class Killed(BaseException):
    """Stands for SIGKILL."""


def write(folder, text):
    def fill(fresh):
        (fresh / "a").write_text(text)
        (fresh / "b").write_text(text)

    files.write_folder(folder, fill)


def read(folder):
    result = files.find_folder(folder)
    texts = {(result / name).read_text() for name in "ab"}
    assert len(texts) == 1, "a folder of two versions"
    return texts.pop()


def killed_while_writing(monkeypatch, folder, text, after):
    """Write a folder, killed before operation number `after`; return whether it was killed."""
    left = iter(range(after))

    def fused(operation):
        def run(*arguments, **options):
            if next(left, None) is None:
                raise Killed
            return operation(*arguments, **options)

        return run

    with monkeypatch.context() as patch:
        operations = ((Path, "rename"), (Path, "mkdir"), (Path, "write_text"), (shutil, "rmtree"))
        for owner, name in operations:
            patch.setattr(owner, name, fused(getattr(owner, name)))
        try:
            write(folder, text)
        except Killed:
            return True
    return False


def test_a_complete_folder_remains_after_two_kills(tmp_path, monkeypatch):
    for first in range(9):
        for second in range(10):
            folder = tmp_path / f"{first}-{second}" / "last"
            write(folder, "1")
            killed = killed_while_writing(monkeypatch, folder, "2", first)
            assert killed or first >= 7
            before = read(folder)
            assert before in {"1", "2"}
            killed_while_writing(monkeypatch, folder, "3", second)
            assert read(folder) in {before, "3"}


def test_links_and_rights_are_kept(tmp_path):
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "target", tmp_path / "link"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link.symlink_to("folder/target")
    files.write_file(link, b"new")
    assert target.read_bytes() == b"new"
    assert link.readlink() == Path("folder/target")
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert list(target.parent.iterdir()) == [target]


def table(folder, text):
    path = folder / "table.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    return path


def test_csv_columns_are_read_by_name(tmp_path):
    path = table(tmp_path, "a, note ,b\n1,x,2\n\n3,y,4.5\n")
    table_columns = files.read_csv(path, ("b", "a", "time"), ("time",))
    values = {name: column.tolist() for name, column in table_columns.items()}
    assert values == {"b": [2.0, 4.5], "a": [1.0, 3.0]}
    assert files.read_csv(table(tmp_path, "a,b\n"), ["a"])["a"].shape == (0,)
    assert files.read_csv(table(tmp_path, "b,a,b\n1,2,3,\n"), ["a"])["a"].tolist() == [2.0]


@pytest.mark.parametrize(("text", "place"), [
    ("", ": has no header"),
    ("b\n1", ": column 'a'"),
    ("a;b\n1,5;2", ": .*semicolon"),
    ("a,b,a\n1,2,3", ": .*'a'"),
    ("a\n1\nx", ", row 2, a: "),
    ("a,b\n1,2\n3,4,5", ", row 2: "),
])  # fmt: skip
def test_csv_errors_name_row_and_column(tmp_path, text, place):
    path = table(tmp_path, text)
    with pytest.raises(KinfeasError, match=f"^{path}{place}"):
        files.read_csv(path, ["a"])


@pytest.mark.parametrize(
    "content", [b"{}x", b"[]", b"[" * 200_000, b"\xff", b"{" + b" " * 1_000_000 + b"}"]
)
def test_files_that_are_no_json_mapping(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(KinfeasError, match=f"^{path}: "):
        files.read_json(path)
