"""The command `kinfeas`.

Modules that are slow to import are imported within the commands, so that help appears at once.
"""

import sys
import traceback
from typing import Annotated

import typer
from typer.exceptions import TyperException

from kinfeas import __version__
from kinfeas.cli.benchmark import benchmark
from kinfeas.cli.dataset import dataset
from kinfeas.cli.demo import demo
from kinfeas.cli.deploy import deploy, servo
from kinfeas.cli.evaluate import ceiling, evaluate
from kinfeas.cli.export import export
from kinfeas.cli.fit import fit
from kinfeas.cli.play import play
from kinfeas.cli.plugins import app as plugins
from kinfeas.cli.robot import app as robot
from kinfeas.cli.simulate import simulate
from kinfeas.cli.sweep import sweep
from kinfeas.cli.train import train
from kinfeas.cli.view import view
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe, raised_by
from kinfeas.core.extras import missing_extra

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"max_content_width": 100},
)
for _command in (
    demo, train, sweep, evaluate, benchmark, ceiling, export, deploy, servo,
    play, simulate, view, fit, dataset,
):  # fmt: skip
    app.command()(_command)
app.add_typer(plugins, name="plugins")
app.add_typer(robot, name="robot")


def main() -> None:
    """Run the command line; exit with 2 and one line on bad input, with 130 on Ctrl-C."""
    try:
        code = app(standalone_mode=False)
    except (KinfeasError, TyperException, OSError) as error:
        if message := _message(error):
            sys.stderr.write(f"error: {' '.join(message.split())}\n")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except PLUGIN_ERRORS as error:
        if missing := missing_extra(error):
            sys.stderr.write(f"error: {missing}\n")
            sys.exit(2)
        if raised_by(error) is None:
            raise
        traceback.print_exc()  # for the author of the plugin
        sys.stderr.write(f"error: {describe(error)}\n")
        code = 2
    sys.exit(code if isinstance(code, int) else 0)


def _message(error: Exception) -> str:
    if isinstance(error, TyperException):
        return error.format_message()
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    text = error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return "; ".join([text, *getattr(error, "__notes__", ())])  # notes name plugins


def _print_version(requested: bool) -> None:
    if requested:
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
    """Learned base motions that keep any end-effector (EE) motion kinematically feasible.

    Register a motion generator (plugins new), train a base policy (train, evaluate), run it on a
    robot (export, deploy). Units are metres, radians and seconds; poses are x y z qx qy qz qw in
    the world frame.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
