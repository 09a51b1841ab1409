"""Directives of the reference: `commands` from the command line, `modules` from docstrings."""

import re
from collections.abc import Iterator
from typing import Any

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from kinfeas.cli.main import app as program

MODULE = """
## {0}

```{{eval-rst}}
.. automodule:: {0}
   :members:
   :show-inheritance:
```
"""


class Commands(SphinxDirective):
    """Sections with help, options and examples of every command."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        return self.parse_text_to_nodes("\n".join(_reference()), allow_section_headings=True)


class Modules(SphinxDirective):
    """Sections with the docstrings of the modules in the content, one name a line."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        text = "\n".join(MODULE.format(name) for name in self.content if name)
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def _reference() -> Iterator[str]:
    """Yield the lines of a Markdown text."""
    for name, command in _commands("kinfeas", typer.main.get_command(program)):
        yield from _section(name, command)


def _commands(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    for part, inner in getattr(command, "commands", {}).items():
        yield from _commands(f"{name} {part}", inner)
    if not hasattr(command, "commands"):
        yield name, command


def _section(name: str, command: Any) -> Iterator[str]:
    context = command.context_class(command, info_name=name)
    usage = " ".join(command.collect_usage_pieces(context))
    yield from (f"## {name}", "", "```text", f"{name} {usage}", "```", "")
    yield from (re.sub(r"Example: (.*)", r"Example: `\1`", command.help), "")
    yield from ("| | | default |", "|---|---|---|")
    for parameter in command.params:
        yield f"| {' | '.join(_row(parameter, context))} |"
    yield ""


def _row(parameter: Any, context: Any) -> tuple[str, str, str]:
    record = parameter.get_help_record(context) or ("", "")
    called = str(record[0])
    text, _, extra = str(record[1]).partition("  [")
    found = re.search(r"default: (.*?)(?:;|\])", extra)
    default = found.group(1).strip("()") if found else ""
    default = "required" if parameter.required else default
    return f"`{_cell(called)}`", _cell(text), _cell(default)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("commands", Commands)
    app.add_directive("modules", Modules)
    return {"parallel_read_safe": True}
