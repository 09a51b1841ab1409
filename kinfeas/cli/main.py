"""The command `kinfeas`.

Whatever is slow to import is imported within the commands, so that help appears at once.
"""

import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from kinfeas import __version__
from kinfeas.cli import (
    benchmark,
    ceiling,
    demo,
    demonstrate,
    deploy,
    evaluate,
    export,
    fit,
    plugins,
    simulate,
    speed,
    train,
    view,
)
from kinfeas.errors import KinfeasError

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("demo")(demo.demo)
app.command("train")(train.train)
app.command("evaluate")(evaluate.evaluate)
app.command("benchmark")(benchmark.benchmark)
app.command("ceiling")(ceiling.ceiling)
app.command("demonstrate")(demonstrate.demonstrate)
app.command("deploy")(deploy.deploy)
app.command("fit")(fit.fit)
app.command("export")(export.export)
app.command("simulate")(simulate.simulate)
app.command("speed")(speed.speed)
app.command("view")(view.view)
app.add_typer(plugins.app, name="plugins")


def main() -> None:
    """Run the command line; exit with 2 and one line on bad input, with 130 on Ctrl-C."""
    try:
        code = app(standalone_mode=False)
    except (KinfeasError, TyperException) as error:
        message = error.format_message() if isinstance(error, TyperException) else str(error)
        if message:
            sys.stderr.write(f"error: {' '.join(message.split())}\n")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    sys.exit(code if isinstance(code, int) else 0)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"kinfeas {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _global_options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Learned base motions that keep any end-effector motion kinematically feasible."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
