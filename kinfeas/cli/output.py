"""Output of commands: JSON, tables, and progress on standard error."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import typer

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.io import files
from kinfeas.io.files import replaced, writing

if TYPE_CHECKING:
    from rich.text import Text

    from kinfeas.api import OnProgress

LINE_SECONDS = 15.0
"""Time between lines on progress where standard error is no terminal."""


class Advance(Protocol):
    """Reports progress."""

    def __call__(self, amount: float, text: str = "") -> None:
        """Add an amount that has been done; `text` replaces the description."""


def check_file_path(path: Path | None) -> Path | None:
    """Return `path` if a file can be written there, before any work is done."""
    if path is not None:
        with writing(path):
            if (target := replaced(path)) is not None:
                tempfile.TemporaryFile(dir=target.parent).close()
    return path


def check_suffix(path: Path, *suffixes: str) -> None:
    """Raise KinfeasError if a file has another suffix."""
    if path.suffix.lower() not in suffixes:
        raise KinfeasError(f"{path}: must end in {' or '.join(suffixes)}")


STDOUT = Path("-")
"""Standard output, as the path of a JSON file."""


def write_json(data: object, path: Path | None) -> None:
    """Write `data` as JSON, atomically or to standard output; nothing for None."""
    if path == STDOUT:
        print(files.to_json(data), end="", file=sys.__stdout__)
    elif path is not None:
        files.write_json(data, path)


def write_drawing(content: Callable[[], bytes], path: Path | None) -> None:
    """Write a picture or page, atomically, and print its path; nothing for None."""
    if path is not None:
        with status("drawing"):
            files.write_file(path, content())
        print_paths(path)


def print_paths(*paths: Path | None) -> None:
    """Print the paths of files that have been written."""
    for path in paths:
        if path is not None:
            typer.echo(str(path))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence["str | Text"]]) -> None:
    """Print rows of text; columns whose name begins with a blank are aligned right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=_plain(title, "table.title"), title_justify="left")
    for column in columns:
        side: Literal["left", "right"] = "right" if column.startswith(" ") else "left"
        table.add_column(_plain(column.strip()), justify=side, overflow="fold")
    for row in rows:
        table.add_row(*(_plain(cell) if isinstance(cell, str) else cell for cell in row))
    Console().print(table)


def print_facts(title: str, facts: Mapping[str, object]) -> None:
    """Print nested facts below a title as YAML, numbers with four digits."""
    typer.echo(f"{title}\n")
    typer.echo(strict_yaml.to_text(_rounded(facts), compact=True))


def _rounded(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


@contextmanager
def progress(text: str, total: float = 1.0) -> Iterator[Advance]:
    """Show a bar on standard error, or a line every `LINE_SECONDS` where it is no terminal.

    Yields a function that takes the amount that has just been done.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(text, total)
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(escape(text), total=total)

        def advance(amount: float, text: str = text) -> None:
            bar.update(task, advance=amount, description=escape(text))

        yield advance


@contextmanager
def phases() -> Iterator["OnProgress"]:
    """Show the present work with a bar or lines, as in `progress`; yields its `OnProgress`."""
    with ExitStack() as bar:
        work, done = "", 0.0
        advance: Advance | None = None

        def report(text: str, fraction: float) -> None:
            nonlocal work, done, advance
            if advance is None or text != work:
                bar.close()
                advance, work, done = bar.enter_context(progress(text)), text, 0.0
            advance(fraction - done)
            done = fraction

        yield report


@contextmanager
def status(text: str) -> Iterator[ExitStack]:
    """Show the present work on standard error, until the block or what it yields is closed."""
    from rich.console import Console
    from rich.markup import escape

    with ExitStack() as open_status:
        open_status.enter_context(Console(stderr=True).status(escape(text)))
        yield open_status


def percent(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Return a share in 0-1 as per cent, with its interval if there is one; `-` for None."""
    if value is None:
        return "-"
    interval = "" if low is None or high is None else f"  ({100 * low:.1f} - {100 * high:.1f})"
    return f"{100 * value:.1f} %{interval}"


def minutes(seconds: float) -> str:
    """Return a time as minutes and seconds, such as `75:03`."""
    whole, rest = divmod(round(seconds), 60)
    return f"{whole}:{rest:02d}"


class _Lines:
    """Writes lines on progress."""

    def __init__(self, text: str, total: float) -> None:
        self._text, self._total, self._done = text, total, 0.0
        self._begun = self._last = time.monotonic()

    def __call__(self, amount: float, text: str = "") -> None:
        self._done += amount
        now = time.monotonic()
        if now - self._last < LINE_SECONDS or self._done <= 0.0:
            return
        self._last = now
        done = min(self._done / self._total, 1.0)
        left = minutes((now - self._begun) * (1.0 - done) / done)
        sys.stderr.write(f"{done:4.0%}  {text or f'{self._text}, {left} left'}\n")
        sys.stderr.flush()


def _plain(words: str, style: str = "") -> "Text":
    """Return a text without markup and control characters."""
    from rich.text import Text

    return Text("".join(letter if letter.isprintable() else "?" for letter in words), style)
