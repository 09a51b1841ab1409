"""Single files: read up to a limit, written as a whole, and failures that name them."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from kinfeas.core.errors import KinfeasError

_STREAMS = {"/dev/stdout": 1, "/dev/stderr": 2}


def is_path(name: object) -> bool:
    """Return whether a robot, a task and the like is meant by the path of its YAML, not by name."""
    if isinstance(name, str):
        return os.sep in name or name.endswith((".yaml", ".yml"))
    return isinstance(name, Path)


def is_standard_output(path: Path) -> bool:
    """Return whether writing to `path` writes to this process's standard output."""
    return _stream(path) == 1


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn a failure to read into a `KinfeasError` that names `path`.

    A device or a pipe is one: it could be waited for, or read, without end.
    """
    with _naming(path, "read"):
        mode = _mode(path)
        if mode and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise OSError("it is not a regular file")
        yield


def writing(path: Path) -> AbstractContextManager[None]:
    """Turn a failure to write into a `KinfeasError` that names `path`."""
    return _naming(path, "written")


@contextmanager
def _naming(path: Path, done: str) -> Iterator[None]:
    if not _is_file_name(path):
        raise KinfeasError(f"{str(path)!r}: cannot be {done}: no file can be called so")
    try:
        yield
    except OSError as error:
        relative = isinstance(error, FileNotFoundError) and not path.is_absolute()
        where = f" in {Path.cwd()}" if relative else ""
        raise KinfeasError(f"{path}: cannot be {done}: {error.strerror or error}{where}") from error
    except UnicodeDecodeError as error:
        raise KinfeasError(f"{path}: not a text file in UTF-8") from error


def _is_file_name(path: Path) -> bool:
    """Return whether the system takes a path for one: without NUL and lone surrogates."""
    try:
        return b"\0" not in os.fsencode(path)
    except UnicodeEncodeError:
        return False


def read_file(path: Path, most: int) -> bytes:
    """Return what a file of at most `most` bytes holds.

    Raises:
        KinfeasError: If it cannot be read, or is larger.
    """
    with reading(path), path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise KinfeasError(f"{path}: too large, at most {most} bytes are allowed")
    return content


def write_file(path: Path, content: bytes) -> None:
    """Write a file, all of it or nothing, as `replacing` does.

    Raises:
        KinfeasError: If it cannot be written.
    """
    with replacing(path) as fresh:
        fresh.write_bytes(content)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield where to write a file of the same name, which takes the place of `path` when complete.

    A link stays, and what it leads to is replaced. A device, a pipe or `/dev/stdout` stays too: it
    is handed what was written.

    Raises:
        KinfeasError: If it cannot be written; what was there is still there.
    """
    target = replaced(path)
    with writing(path), TemporaryDirectory(prefix=".", dir=target and target.parent) as folder:
        fresh = Path(folder) / path.name
        yield fresh
        if target is None:
            _hand_over(fresh, path)
        else:
            if target.exists():
                shutil.copymode(target, fresh)
            fresh.replace(target)


def replaced(path: Path) -> Path | None:
    """Return the file that writing to `path` begins or replaces, links followed.

    None if `path` is a device, a pipe or an open file such as `/dev/stdout`, which all stay.

    Raises:
        KinfeasError: If it is a folder, or must not be written.
    """
    with writing(path):
        stream = _stream(path)
        if stream is not None:
            os.fstat(stream)
            return None
        mode = _mode(path)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if mode and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return path.resolve() if not mode or stat.S_ISREG(mode) else None


def _mode(path: Path) -> int:
    """Return the kind and the rights of what is there, 0 if there is nothing."""
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return 0


def _stream(path: Path) -> int | None:
    """Return the number of the open file of this process that `path` stands for, if it does."""
    if str(path) in _STREAMS:
        return _STREAMS[str(path)]
    open_file = path.name.isdecimal() and path.exists()
    own = open_file and path.parent.resolve() == Path("/dev/fd").resolve()
    return int(path.name) if own else None


def _hand_over(fresh: Path, path: Path) -> None:
    stream = _stream(path)
    sink = path.open("wb") if stream is None else os.fdopen(os.dup(stream), "wb")
    with fresh.open("rb") as source, sink:
        shutil.copyfileobj(source, sink)
