"""`kinfeas plugins new`: a small distribution to begin with."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from kinfeas.templates import Kind


def new(
    name: Annotated[str, typer.Argument(help="What it will be called, such as my_motion.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write it into; by default ./kinfeas-NAME."),
    ] = None,
    kind: Annotated[Kind, typer.Option("--kind", help="What it offers.")] = Kind.MOTION_GENERATOR,
) -> None:
    """Write a complete distribution: an entry point, a working example, its test and a README.

    [bold]pip install DIR[/] and [bold]pytest DIR[/] work at once; then change what it does.
    """
    from kinfeas.templates.distribution import write_distribution

    folder = out or Path(f"kinfeas-{name.replace('_', '-')}")
    for path in write_distribution(kind, name, folder):
        typer.echo(str(path))
    quoted = shlex.quote(str(folder))
    typer.echo(f"install it: pip install -e {quoted}\ntest it: pytest {quoted}")
