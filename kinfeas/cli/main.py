"""The command `kinfeas`.

Modules that are slow to import are imported within the commands, so that help appears at once.
"""

import sys
import traceback
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from kinfeas import __version__
from kinfeas.cli.demo import demo
from kinfeas.cli.demonstrations import dataset, fit
from kinfeas.cli.deploy import deploy, servo, simulate
from kinfeas.cli.evaluate import benchmark, ceiling, evaluate
from kinfeas.cli.identify import identify
from kinfeas.cli.plugins import app as plugins
from kinfeas.cli.reach import plan, reach, serve
from kinfeas.cli.robot import app as robot
from kinfeas.cli.train import export, sweep, train
from kinfeas.cli.view import play, view
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe, plugin_frames, raised_by
from kinfeas.core.extras import missing_extra


class _Group(TyperGroup):
    """A group that shows whole summaries of its commands, which Typer cuts in narrow terminals."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for command in self.commands.values():
            command.short_help = command.get_short_help_str(limit=1000)
        super().format_commands(ctx, formatter)


class _Commands(_Group):
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            sys.stderr.write("interrupted\n")
            raise


app = typer.Typer(
    cls=_Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"max_content_width": 100},
)
for _command in (
    demo, train, sweep, evaluate, benchmark, ceiling, reach, plan, export, deploy, servo,
    identify, play, serve, simulate, view, fit, dataset,
):  # fmt: skip
    app.command()(_command)
app.add_typer(plugins, name="plugins", cls=_Group)
app.add_typer(robot, name="robot", cls=_Group)


def main() -> None:
    """Run the command line; exit with 2 and one line on bad input, with 130 on Ctrl-C."""
    message: str | None
    try:
        code = app(standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except TyperException as error:
        message = error.format_message()
        if type(error).__name__ == "NoArgsIsHelpError":  # typer does not export the class
            typer.echo(message)
            sys.exit(2)
        option = getattr(error, "param", None)
        if option is not None and option.nargs > 1:
            message = f"{option.get_error_hint()} needs {option.nargs} numbers"
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    except (KinfeasError, OSError) as error:
        message = describe(error) if raised_by(error) else str(error)
    except PLUGIN_ERRORS as error:
        message = missing_extra(error)
        if message is None and raised_by(error) is None:
            raise
        if message is None:
            # The traceback within the plugin, for its author.
            traceback.print_exception(error, limit=-plugin_frames(error))
            message = describe(error)
    if message:
        sys.stderr.write(f"error: {' '.join(message.split())}\n")
    sys.exit(2)


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
