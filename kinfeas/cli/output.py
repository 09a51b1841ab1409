"""Output of commands: JSON, tables, and progress on standard error."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kinfeas.config import strict_yaml
from kinfeas.core import files

if TYPE_CHECKING:
    from rich.status import Status
    from rich.text import Text

    from kinfeas.api import OnProgress
    from kinfeas.io.run_log import Moment

LINE_SECONDS = 15.0
"""Seconds between lines on progress where standard error is no terminal."""

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
        if path not in (None, STDOUT):
            typer.echo(str(path))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of text; columns whose name begins with a blank are aligned right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=_plain(title, "table.title"), title_justify="left")
    for column in columns:
        side: Literal["left", "right"] = "right" if column.startswith(" ") else "left"
        table.add_column(_plain(column.strip()), justify=side, overflow="fold")
    for row in rows:
        table.add_row(*map(_plain, row))
    Console().print(table)


def print_facts(title: str, facts: Mapping[str, object]) -> None:
    """Print nested facts below a title as YAML, numbers with four significant digits."""
    rounded = json.loads(json.dumps(facts), parse_float=lambda text: float(f"{float(text):.4g}"))
    typer.echo(f"{title}\n\n{strict_yaml.to_text(rounded, compact=True)}")


@contextmanager
def progress() -> Iterator["OnProgress"]:
    """Show progress on standard error: as a bar, or as lines if that is no terminal."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    console, printed = Console(stderr=True), time.monotonic()

    def write_line(text: str, fraction: float) -> None:
        nonlocal printed
        if time.monotonic() - printed >= LINE_SECONDS:
            printed = time.monotonic()
            sys.stderr.write(f"{fraction:4.0%}  {text}\n")

    if not console.is_terminal:
        yield write_line
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def show(text: str, fraction: float) -> None:
            if fraction < bar.tasks[0].completed:  # new work, with another speed
                bar.reset(task)
            bar.update(task, completed=fraction, description=escape(text))

        yield show


@contextmanager
def status(text: str) -> Iterator["Status"]:
    """Show a spinner on standard error during work of unknown length."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True)
    with console.status(escape(text)) as shown:
        yield shown


@contextmanager
def run_status(*, goal: bool = True) -> Iterator[Callable[["Moment"], None]]:
    """Show the state of a run on standard error: each second, or as lines if that is no terminal.

    The distance to the goal is left out for runs without a `goal`.
    """
    from rich.console import Console

    console, printed = Console(stderr=True), 0.0

    def show(moment: "Moment") -> None:
        nonlocal printed
        if moment.time < printed + (1.0 if console.is_terminal else LINE_SECONDS):
            return
        printed = moment.time
        away = math.dist(moment.goal[:3], moment.desired[:3])
        distance = f", {away:.2f} m before the goal" if goal else ""
        text = f"moving for {printed:.0f} s{distance}; Ctrl-C stops"
        with suppress(OSError):  # the terminal may have been closed
            if console.is_terminal:
                shown.update(text)
            else:
                sys.stderr.write(f"{text}\n")

    # Few refreshes, since they take time from the control loop.
    with console.status("preparing", refresh_per_second=4.0) as shown:
        yield show


def percent(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Return a fraction as per cent, with its interval if there is one; `-` for None."""
    if value is None:
        return "-"
    interval = "" if low is None or high is None else f"  ({100 * low:.1f} - {100 * high:.1f})"
    return f"{100 * value:.1f} %{interval}"


def _plain(words: str, style: str = "") -> "Text":
    """Return a text without markup and control characters."""
    from rich.text import Text

    return Text("".join(letter if letter.isprintable() else "?" for letter in words), style)
