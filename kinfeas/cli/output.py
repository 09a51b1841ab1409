"""What commands hand out: JSON, tables, and progress on the way."""

import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinfeas.errors import KinfeasError


def check_file_path(path: Path | None) -> Path | None:
    """Return `path` if a file can be written there, so that no work is done in vain.

    A parameter's callback, for paths of any kind of file.

    Raises:
        KinfeasError: If it cannot.
    """
    if path is not None:
        if path.is_dir():
            raise KinfeasError(f"{path}: is a folder, not the path of a file")
        try:
            tempfile.TemporaryFile(dir=path.parent).close()
        except OSError as error:
            raise KinfeasError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def write_json(data: object, path: Path) -> None:
    """Write `data` as JSON, all of it or nothing.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    from kinfeas.files import write_file

    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    write_file(path, text.encode())


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of text; columns whose name begins with a blank are set flush right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column.strip(), justify="right" if column.startswith(" ") else "left")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def progress(text: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """Show a bar on standard error; yield a function that takes how much has just been done."""
    from rich.progress import Progress

    # Into a file or a pipe, a bar would leave empty lines.
    console = _console()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(text, total=total)
        yield lambda amount: bar.advance(task, amount)


@contextmanager
def status(text: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done on standard error; yield a function that takes what is next."""
    with _console().status(text) as shown:
        yield shown.update


def share(value: float, low: float | None = None, high: float | None = None) -> str:
    """Return a share in 0-1 as per cent, with its interval if there is one."""
    interval = "" if low is None or high is None else f"  ({100 * low:.1f} - {100 * high:.1f})"
    return f"{100 * value:.1f} %{interval}"


def _console() -> Any:
    from rich.console import Console

    return Console(stderr=True)
