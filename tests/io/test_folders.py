import fcntl
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.io.folders import alone, find_folder, write_folder


class Killed(BaseException):
    """What SIGKILL is to a process: nothing of ours catches it."""


def write(folder: Path, text: str) -> None:
    def fill(fresh: Path) -> None:
        (fresh / "a").write_text(text)
        (fresh / "b").write_text(text)

    write_folder(folder, fill)


def read(folder: Path) -> str:
    found = find_folder(folder)
    texts = {(found / name).read_text() for name in "ab"}
    assert len(texts) == 1, "a folder of two versions"
    return texts.pop()


class Fuse:
    """Kills at the n-th operation on the file system, before it is done."""

    def __init__(self, monkeypatch, after):
        self.left = after
        for owner, name in (
            (Path, "rename"), (Path, "mkdir"), (Path, "write_text"), (shutil, "rmtree"),
        ):  # fmt: skip
            monkeypatch.setattr(owner, name, self.wrap(getattr(owner, name)))

    def wrap(self, operation):
        def burning(*arguments, **options):
            self.left -= 1
            if self.left < 0:
                raise Killed
            return operation(*arguments, **options)

        return burning


def killed_while_writing(monkeypatch, folder, text, after):
    """Return whether the writer was killed before it was done."""
    with monkeypatch.context() as patch:
        Fuse(patch, after)
        try:
            write(folder, text)
        except Killed:
            return True
    return False


def test_a_folder_without_a_name_is_found_where_it_is():
    assert find_folder(Path()) == Path()
    assert find_folder(Path("/")) == Path("/")


def test_takes_the_place_of_what_was_there(tmp_path):
    folder = tmp_path / "some" / "last"
    write(folder, "1")
    (folder / "c").write_text("left over")
    write(folder, "2")
    assert read(folder) == "2"
    assert [path.name for path in folder.parent.iterdir()] == ["last"]
    assert sorted(path.name for path in folder.iterdir()) == ["a", "b"]


def test_killed_at_any_moment_a_complete_folder_remains(tmp_path, monkeypatch):
    moments = 0
    while True:
        folder = tmp_path / str(moments) / "last"
        write(folder, "1")
        if not killed_while_writing(monkeypatch, folder, "2", moments):
            break
        assert read(folder) in {"1", "2"}
        moments += 1
        write(folder, "3")
        assert read(folder) == "3"
    assert moments >= 7


def test_killed_twice_a_complete_folder_remains(tmp_path, monkeypatch):
    for first in range(9):
        for second in range(10):
            folder = tmp_path / f"{first}-{second}" / "last"
            write(folder, "1")
            killed_while_writing(monkeypatch, folder, "2", first)
            before = read(folder)
            killed_while_writing(monkeypatch, folder, "3", second)
            assert read(folder) in {before, "3"}


def test_what_was_there_stays_if_the_disk_is_full(tmp_path):
    folder = tmp_path / "last"
    write(folder, "1")

    def fill(fresh):
        (fresh / "a").write_text("2")
        raise OSError(28, "No space left on device")

    with pytest.raises(KinfeasError, match="last: cannot be written: No space left on device"):
        write_folder(folder, fill)
    assert read(folder) == "1"


def test_a_file_in_the_way_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(KinfeasError, match="cannot be written"):
        write(tmp_path / "file" / "last", "1")
    with pytest.raises(KinfeasError, match="cannot be written"):
        write(tmp_path / "file", "1")


def test_finds_nothing_where_nothing_was(tmp_path):
    assert find_folder(tmp_path / "last") == tmp_path / "last"


def test_one_at_a_time_works_in_a_folder(tmp_path):
    with (
        alone(tmp_path),
        pytest.raises(KinfeasError, match="another process is at work in it"),
        alone(tmp_path),
    ):
        pass
    with alone(tmp_path):
        pass


def test_a_killed_process_works_in_no_folder(tmp_path):
    use = """
import sys, time
from pathlib import Path
from kinfeas.io.folders import alone
with alone(Path(sys.argv[1])):
    print("in it", flush=True)
    time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", use, tmp_path], stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"in it\n"
        with pytest.raises(KinfeasError, match="another process"), alone(tmp_path):
            pass
        other.kill()
    with alone(tmp_path):
        pass


def test_where_there_are_no_locks_all_may_work(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with alone(tmp_path), alone(tmp_path):
        pass


def test_nobody_works_in_a_folder_that_is_not_there(tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("nothing", "file"):
        with pytest.raises(KinfeasError, match=f"{name}: cannot be written"):
            alone(tmp_path / name).__enter__()
