"""The command `kinfeas`.

Whatever is slow to import is imported within the commands, so that help appears at once.
"""

import sys
from typing import Annotated

import typer

from kinfeas import __version__
from kinfeas.cli import ceiling, demo, evaluate, plugins, speed, train
from kinfeas.errors import KinfeasError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("demo")(demo.demo)
app.command("train")(train.train)
app.command("evaluate")(evaluate.evaluate)
app.command("ceiling")(ceiling.ceiling)
app.command("speed")(speed.speed)
app.add_typer(plugins.app, name="plugins")


def main() -> None:
    """Run the command line; exit with 2 and one line on bad input, with 130 on Ctrl-C."""
    try:
        app()
    except KinfeasError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"kinfeas {__version__}")
        raise typer.Exit


@app.callback()
def _global_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Learned base motions that keep any end-effector motion kinematically feasible."""
