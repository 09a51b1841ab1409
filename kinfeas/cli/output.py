"""What commands hand out: JSON, tables, and progress on the way."""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from rich.text import Text

LINE_SECONDS = 15.0
"""Time between lines on progress where a bar cannot move: in a log file."""

_SUFFIXES = {"--picture": (".png",), "--html": (".html", ".htm"), "--record": (".csv",)}
"""What the files of options end in."""


def check_file_path(path: Path | None) -> Path | None:
    """Return `path` if a file can be written there, so that no work is done in vain.

    A parameter's callback, for paths of any kind of file.

    Raises:
        KinfeasError: If it cannot.
    """
    from kinfeas.io.files import replaced, writing

    if path is not None:
        with writing(path):
            if path.is_dir():
                raise KinfeasError(f"{path}: is a folder, not the path of a file")
            target = replaced(path)
            if target is not None:
                tempfile.TemporaryFile(dir=target.parent).close()
    return path


def check_apart(paths: Mapping[str, Path | None]) -> None:
    """Check that no two options name the same file, so that what one wrote is not overwritten.

    A device or a pipe may be named twice.

    Args:
        paths: What each option names, by the option; None if it was not given.

    Raises:
        KinfeasError: If two do.
    """
    named: dict[str, str] = {}
    for option, path in paths.items():
        if path is None:
            continue
        first = named.setdefault(os.path.realpath(path), option)
        if first != option and (path.is_file() or not path.exists()):
            raise KinfeasError(f"{first} and {option} must differ, but both name {path}")


def check_outputs(
    written: Mapping[str, Path | None], read: Mapping[str, Sequence[Path]] | None = None
) -> None:
    """Check that what is to be written takes the place of nothing that is read, and is so called.

    Args:
        written: What each option of an output names; None if it was not given.
        read: Files and folders that each option of an input stands for; as in `kinfeas.cli.inputs`.

    Raises:
        KinfeasError: If an output is an input, lies in one, is another output, or ends in another
            suffix than its kind.
    """
    outputs = {option: path for option, path in written.items() if path is not None}
    for source, places in (read or {}).items():
        for place in places:
            for option, path in outputs.items():
                if len(places) == 1:
                    check_apart({source: place, option: path})
                if _is_within(path, place):
                    raise KinfeasError(
                        f"{option}: {path} belongs to what {source} names and is not written over"
                    )
    check_apart(outputs)
    for option, path in outputs.items():
        if option in _SUFFIXES:
            check_suffix(option, path, *_SUFFIXES[option])


def check_suffix(option: str, path: Path, *suffixes: str) -> None:
    """Check that a file is called as its kind is; a device or a pipe may be called anything.

    Raises:
        KinfeasError: If it is not.
    """
    from kinfeas.io.files import replaced

    if path.suffix.lower() not in suffixes and replaced(path) is not None:
        raise KinfeasError(f"{option}: {path} must end in {suffixes[0]}")


def _is_within(path: Path, place: Path) -> bool:
    """Return whether a path, which is no device or pipe, is a file or a folder, or lies in it."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        return False
    inner, outer = (Path(os.path.realpath(one)) for one in (path, place))
    return outer in (inner, *inner.parents)


def write_json(data: object, path: Path) -> None:
    """Write `data` as JSON, all of it or nothing.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    from kinfeas.io.files import write_file

    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    write_file(path, text.encode())


def say_written(*paths: Path | None) -> None:
    """Print where pictures and pages were written to; None, and standard output, is left out."""
    from kinfeas.io.files import is_standard_output

    for path in paths:
        if path is not None and not is_standard_output(path):
            typer.echo(str(path))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence["str | Text"]]) -> None:
    """Print rows of text; columns whose name begins with a blank are set flush right.

    A string is shown as it stands and whole: no part of it is markup or moves the cursor.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=_plain(title, "table.title"), title_justify="left")
    for column in columns:
        side: Literal["left", "right"] = "right" if column.startswith(" ") else "left"
        table.add_column(_plain(column.strip()), justify=side, overflow="fold")
    for row in rows:
        table.add_row(*(_plain(cell) if isinstance(cell, str) else cell for cell in row))
    Console().print(table)


@contextmanager
def progress(text: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """Show a bar on standard error, lines if that is no terminal and it takes its time.

    Yields a function that takes how much has just been done.
    """
    from rich.markup import escape
    from rich.progress import Progress

    console = _console()
    if not console.is_terminal:
        yield _Lines(text, total)
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(escape(text), total=total)
        yield lambda amount: bar.advance(task, amount)


@contextmanager
def status(text: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done on standard error; yield a function that takes what is next."""
    from rich.markup import escape

    with _console().status(escape(text)) as shown:
        yield lambda news: shown.update(escape(news))


def share(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Return a share in 0-1 as per cent, with its interval if there is one; `-` for an unknown."""
    if value is None:
        return "-"
    interval = "" if low is None or high is None else f"  ({100 * low:.1f} - {100 * high:.1f})"
    return f"{100 * value:.1f} %{interval}"


def minutes(seconds: float) -> str:
    """Return a time as minutes and seconds, such as `75:03`."""
    whole, rest = divmod(round(seconds), 60)
    return f"{whole}:{rest:02d}"


class _Lines:
    """Writes every now and then how much has been done."""

    def __init__(self, text: str, total: float) -> None:
        self._text, self._total, self._done = _plain(text).plain, total, 0.0
        self._slow = 0.0  # done with the first call, if that took as long as a line
        self._begun = self._last = time.monotonic()

    def __call__(self, amount: float) -> None:
        self._done += amount
        now = time.monotonic()
        if now - self._last < LINE_SECONDS or self._done <= 0.0:
            return
        self._last = now
        share = min(self._done / self._total, 1.0)
        if self._done == amount:  # kernels were compiled meanwhile: nothing is known of the rest
            self._begun, self._slow = now, share
        left = ""
        if share > self._slow:
            seconds = (now - self._begun) * (1.0 - share) / (share - self._slow)
            left = f", {minutes(seconds)} left"
        sys.stderr.write(f"{share:4.0%}  {self._text}{left}\n")
        sys.stderr.flush()


def _plain(words: str, style: str = "") -> "Text":
    from rich.text import Text

    return Text("".join(one if one.isprintable() else "?" for one in words), style)


def _console() -> Any:
    from rich.console import Console

    return Console(stderr=True)
