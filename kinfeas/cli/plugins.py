"""`kinfeas plugins`: what is installed."""

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, write_json

app = typer.Typer(no_args_is_help=True, help="Show the plugins that are installed.")


@app.command("list")
def list_plugins(json: options.JsonPath = None) -> None:
    """List robots, tasks, motion generators, adapters and backends, and where they come from."""
    from kinfeas.registry import GROUPS, plugins

    found = [plugin for group in GROUPS for plugin in plugins(group)]
    if json is not None:
        write_json([vars(plugin) for plugin in found], json)
    rows = [
        [GROUPS[plugin.group], plugin.name, f"{plugin.distribution} {plugin.version}"]
        for plugin in found
    ]
    print_table("plugins", ["kind", "name", "distribution"], rows)


@app.callback()
def _group() -> None:
    """Keep `list` a command of its own, though it is the only one yet."""
