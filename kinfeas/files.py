"""Single files: read up to a limit, written as a whole, and failures that name them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kinfeas.errors import KinfeasError


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn a failure to read into a `KinfeasError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise KinfeasError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise KinfeasError(f"{path}: not a text file in UTF-8") from error


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a failure to write into a `KinfeasError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise KinfeasError(f"{path}: cannot be written: {error.strerror or error}") from error


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
    """Write a file, all of it or nothing.

    Raises:
        KinfeasError: If it cannot be written.
    """
    temporary = path.parent / f".{path.name}.{os.getpid()}"
    with writing(path):
        try:
            temporary.write_bytes(content)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
