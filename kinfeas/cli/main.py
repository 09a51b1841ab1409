"""The command `kinfeas`.

Whatever is slow to import is imported within the commands, so that help appears at once.
"""

import sys
from collections.abc import Callable
from typing import Annotated

import typer
from typer.exceptions import TyperException

from kinfeas import __version__
from kinfeas.cli import (
    benchmark,
    ceiling,
    demo,
    deploy,
    evaluate,
    export,
    fit,
    plugins,
    robot,
    simulate,
    speed,
    train,
    view,
)
from kinfeas.cli.commands import Command, Group
from kinfeas.cli.docstrings import unwrapped
from kinfeas.cli.examples import epilog
from kinfeas.core.errors import KinfeasError

app = typer.Typer(cls=Group, pretty_exceptions_enable=False, rich_markup_mode="rich")
_PANELS: dict[str, dict[str, Callable[..., None]]] = {
    "See and train": {
        "demo": demo.demo,
        "train": train.train,
        "evaluate": evaluate.evaluate,
        "benchmark": benchmark.benchmark,
        "ceiling": ceiling.ceiling,
        "speed": speed.speed,
    },
    "Motions and scenes": {
        "fit": fit.fit,
        "view": view.view,
    },
    "Robots": {
        "export": export.export,
        "deploy": deploy.deploy,
        "simulate": simulate.simulate,
    },
}
for _panel, _commands in _PANELS.items():
    for _name, _command in _commands.items():
        app.command(
            _name,
            cls=Command,
            help=unwrapped(_command),
            rich_help_panel=_panel,
            epilog=epilog(_name),
        )(_command)
app.add_typer(plugins.app, name="plugins", rich_help_panel="Motions and scenes")
app.add_typer(robot.app, name="robot", rich_help_panel="Robots")


def main() -> None:
    """Run the command line; exit with 2 and one line on bad input, with 130 on Ctrl-C.

    What the system refuses, such as a look into a folder that one may not enter, is bad input, too.
    """
    try:
        code = app(standalone_mode=False)
    except (KinfeasError, TyperException, OSError) as error:
        if message := _message(error):
            sys.stderr.write(f"error: {' '.join(message.split())}\n")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    sys.exit(code if isinstance(code, int) else 0)


def _message(error: Exception) -> str:
    if isinstance(error, TyperException):
        return error.format_message()
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"kinfeas {__version__}")
        raise typer.Exit


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

    Three uses: register a motion generator ([bold]plugins new[/]), train a policy
    ([bold]train[/], [bold]evaluate[/]), run it on a robot ([bold]export[/], [bold]deploy[/]).
    Units are metres, radians and seconds; poses are x y z qx qy qz qw in the world frame.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.callback(invoke_without_command=True, help=unwrapped(_global_options))(_global_options)
