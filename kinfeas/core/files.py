"""Files and folders: CSV and JSON, atomic writing, locks, errors with paths."""

import csv
import errno
import fcntl
import hashlib
import json
import os
import shutil
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, Any

from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:  # commands start faster without
    import numpy as np
    from numpy.typing import NDArray

MAX_JSON_BYTES = 1_000_000


def is_path(name: object) -> bool:
    """Return whether a robot, task or scene is named by a path: with a slash, or a YAML file."""
    if isinstance(name, str):
        return os.sep in name or name in {".", ".."} or name.endswith((".yaml", ".yml"))
    return isinstance(name, Path)


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a folder of ROS 2, or a file by its suffix."""
    return path.suffix in (".bag", ".db3", ".mcap") or path.is_dir()


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Convert errors of reading into a `KinfeasError` that names `path`; reject devices, pipes."""
    with _naming(path, "read"):
        mode = _mode(path)
        if mode and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise OSError("it is not a regular file")
        yield


def writing(path: Path) -> AbstractContextManager[None]:
    """Convert errors of writing into a `KinfeasError` that names `path`."""
    return _naming(path, "written")


def read_file(path: Path, max_bytes: int) -> bytes:
    """Return a file's content; raise KinfeasError beyond `max_bytes` or if it is unreadable."""
    with reading(path), path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise KinfeasError(f"{path}: too large, at most {max_bytes} bytes are allowed")
    return content


def read_csv(
    path: Path, columns: Sequence[str], optional: Collection[str] = ()
) -> "dict[str, NDArray[np.float64]]":
    """Return columns of a CSV file by name, NaN where a row has no entry.

    Those in `optional` may be missing. Columns of the file beyond `columns` are ignored.

    Raises:
        KinfeasError: If the file cannot be read, a column is missing or there twice, a row is
            longer than the header, or an entry is no number.
    """
    import numpy as np

    names, rows = _read_rows(path)
    table_columns = {}
    for name in columns:
        if names.count(name) > 1:
            raise KinfeasError(f"{path}: column {name!r} is there {names.count(name)} times")
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


def _read_rows(path: Path) -> tuple[Sequence[str], list[dict[Any, Any]]]:
    """Return the names and the rows of a CSV file."""
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True, strict=True)
            rows, names = list(table), table.fieldnames
    except csv.Error as error:
        raise KinfeasError(f"{path}: is no CSV file: {error}") from error
    if names and len(names) == 1 and ";" in names[0]:
        raise KinfeasError(f"{path}: the separator is a semicolon; it must be a comma")
    if not names:
        raise KinfeasError(f"{path}: has no header; the file or its first line is empty")
    for i, row in enumerate(rows):
        if any(row.get(None, ())):  # entries beyond the header
            raise KinfeasError(f"{path}, row {i + 1}: has more entries than the header")
    return names, rows


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file atomically; raise KinfeasError if it cannot be written."""
    with replacing(path) as fresh, fresh.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


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


def file_hash(path: Path) -> str:
    """Return `sha256:` and the hash of a file's content."""
    with path.open("rb") as file:
        return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"


def named_file_hashes(settings: object) -> list[str]:
    """Return the hashes of the files that plain settings name, such as learned motions."""
    if isinstance(settings, Mapping):
        settings = list(settings.values())
    if isinstance(settings, list):
        return [digest for value in settings for digest in named_file_hashes(value)]
    if not isinstance(settings, str) or not Path(settings).is_file():
        return []
    return [file_hash(Path(settings))]


def check_undamaged(path: Path, written: str | None) -> None:
    """Raise KinfeasError unless the `file_hash` is the one `written`; None if it is unknown."""
    with reading(path):
        if written is not None and written != file_hash(path):
            raise KinfeasError(f"{path}: is damaged: its SHA-256 has changed")


def check_new(path: str | Path | None) -> None:
    """Raise KinfeasError if there is a file or folder at `path`."""
    if path is not None and Path(path).exists():
        raise KinfeasError(f"{path}: exists")


def check_file_path(path: Path | None) -> Path | None:
    """Return `path`; raise KinfeasError if no file can be written there."""
    if path is not None:
        with writing(path):
            if (target := replacement_target(path)) is not None:
                TemporaryFile(dir=target.parent).close()
    return path


def write_file(path: Path, content: bytes) -> None:
    """Write a file atomically; raise KinfeasError if it cannot be written."""
    with replacing(path) as fresh:
        fresh.write_bytes(content)


def to_json(data: object) -> str:
    """Return plain data as indented JSON; ValueError for infinity and NaN."""
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def write_json(data: object, path: Path) -> None:
    """Write plain data as a JSON file, atomically."""
    write_file(path, to_json(data).encode())


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path of the same name whose content replaces `path` at the end.

    Links are followed. The content is copied into devices and pipes. If it cannot be written, the
    old content remains.
    """
    with writing(path):
        target = replacement_target(path)
        with TemporaryDirectory(prefix=".", dir=target and target.parent) as folder:
            fresh = Path(folder) / path.name
            yield fresh
            if target is None:
                with fresh.open("rb") as source, path.open("wb") as sink:
                    shutil.copyfileobj(source, sink)
            else:
                if target.exists():
                    shutil.copymode(target, fresh)
                fresh.replace(target)


def replacement_target(path: Path) -> Path | None:
    """Return the file that writing to `path` replaces; None for devices and pipes."""
    mode = _mode(path)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if mode and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return path.resolve() if not mode or stat.S_ISREG(mode) else None


def write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Replace a folder by a new one that `fill(path)` writes.

    At any moment `find_folder` finds a complete folder, also after a kill.
    """
    from safetensors import SafetensorError

    fresh, old = folder.parent / f".{folder.name}.new", _old(folder)
    with writing(folder):
        if old.is_dir() and not folder.is_dir():
            old.rename(folder)  # a kill between the two renames below
        for leftover in (fresh, old):
            shutil.rmtree(leftover, ignore_errors=True)
        fresh.mkdir(parents=True)
        try:
            fill(fresh)
        except SafetensorError as error:
            raise KinfeasError(f"{folder}: cannot be written: {error}") from error
        if folder.is_dir():
            folder.rename(old)
        fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def find_folder(folder: Path) -> Path:
    """Return `folder`, or its previous version if a process was killed while replacing it."""
    old = _old(folder)
    return old if old.is_dir() and not folder.is_dir() else folder


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder, if its file system has locks; raise KinfeasError if another process has it."""
    with writing(folder):
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not try_lock(lock):
            raise KinfeasError(f"{folder}: another process is at work in it")
        yield
    finally:
        os.close(lock)


def try_lock(descriptor: int) -> bool:
    """Lock an open file without waiting; return False if another process has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # the file system has no locks
    return True


@contextmanager
def _naming(path: Path, done: str) -> Iterator[None]:
    try:
        yield
    except KinfeasError:
        raise
    except UnicodeDecodeError as error:
        raise KinfeasError(f"{path}: not a text file in UTF-8") from error
    except OSError as error:
        relative = isinstance(error, FileNotFoundError) and not path.is_absolute()
        where = f" in {Path.cwd()}" if relative else ""
        raise KinfeasError(f"{path}: cannot be {done}: {error.strerror or error}{where}") from error
    except ValueError as error:  # of a reader, or of a path with NUL or a lone surrogate
        name = str(path) if str(path).isprintable() else repr(str(path))
        raise KinfeasError(f"{name}: cannot be {done}: {error}") from error


def _mode(path: Path) -> int:
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return 0


def _old(folder: Path) -> Path:
    return folder.parent / f".{folder.name}.old"
