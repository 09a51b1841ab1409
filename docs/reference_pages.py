"""Write the generated parts of `docs/reference` from the program: `make reference`.

A part lies between two comments of a page. The first one names its kind and contents:

    <!-- commands -->                           help, options and examples of every command
    <!-- keys kinfeas.jobs.sweep:SweepConfig --> keys of a YAML file, from its dataclass
    <!-- parameters kinfeas.viz.gym:BaseMotionEnv --> parameters of a constructor
    <!-- plugins kinfeas.filters -->            the project's own plugins of a kind
    <!-- modules kinfeas.core.spatial ... -->   public functions and classes

and `<!-- end -->` ends it. Nothing depends on the machine or the width of a terminal.
"""

import ast
import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import typer
from annotated_types import Interval

from kinfeas import config
from kinfeas.cli.main import app

ROOT = Path(__file__).parents[1]
PAGES = Path(__file__).parent / "reference"
PART = re.compile(r"(<!-- (\w+)([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
SOURCES = ("plugins", "scenes", "sim2real", "configs")  # folders beside kinfeas/, within it later
PASSED = ("backend", "robot")  # parameters of plugins that the program itself passes
WORDS = {float: "number", int: "integer", bool: "true or false", str: "text", Path: "path"}
WORDS |= {object: "any", config.PluginSpec: "name, or mapping with `name`"}
NO_VALUE = (MISSING, inspect.Parameter.empty)


def filled(page: str) -> str:
    """Return the text of a page with its generated parts written anew."""
    return PART.sub(
        lambda part: f"{part[1]}\n{_content(part[2], part[3].split())}\n{part[4]}", page
    )


def _content(kind: str, names: list[str]) -> str:
    lines = [line for part in PARTS[kind](*names) for line in (part, "")]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


def _commands() -> Iterator[str]:
    for name, command in sorted(_leaves("kinfeas", typer.main.get_command(app))):
        context = command.context_class(command, info_name=name)
        yield f"## {name}"
        yield f"`{name} {' '.join(command.collect_usage_pieces(context))}`"
        yield re.sub(r"Example: (.*)", r"Example: `\1`", inspect.cleandoc(command.help))
        options = [_option(parameter, context) for parameter in command.params]
        yield _table(("option", "meaning", "default"), options)


def _leaves(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    for part, inner in getattr(command, "commands", {}).items():
        yield from _leaves(f"{name} {part}", inner)
    if not hasattr(command, "commands"):
        yield name, command


def _option(parameter: Any, context: Any) -> tuple[str, str, str]:
    record = parameter.get_help_record(context) or ("", "")
    text, _, extra = str(record[1]).partition("  [")
    found = re.search(r"default: (.*?)(?:; (?:required|[x\d])|\])", extra)
    default = found.group(1).strip("()") if found else ""
    return f"`{record[0]}`", text, "required" if parameter.required else default


def _keys(target: str, *without: str) -> Iterator[str]:
    rows = [
        row for row in _rows(_load(target)) if row[0].strip("`").partition(".")[0] not in without
    ]
    yield _table(("key", "type", "default", "meaning"), rows)


def _rows(schema: Any, above: str = "") -> Iterator[tuple[str, str, str, str]]:
    """Yield key, type, default and meaning of each field, those of nested dataclasses dotted."""
    types, meanings = get_type_hints(schema, include_extras=True), _documented(schema)
    for entry in fields(schema):
        kind, meaning = types[entry.name], _meaning(schema, meanings, entry.name)
        value = entry.default_factory() if callable(entry.default_factory) else entry.default
        nested = _nested(kind, entry.name)
        if nested is None:
            yield f"`{above}{entry.name}`", _type(kind), _default(value), meaning
            continue
        if not (is_dataclass(value) and nested[0] == entry.name):
            yield f"`{above}{entry.name}`", _type(kind), _default(value), meaning
        yield from _rows(nested[1], f"{above}{nested[0]}.")


def _nested(kind: Any, key: str) -> tuple[str, Any] | None:
    """Return the key and the dataclass of a block, of the entries of a list or of a mapping."""
    if isinstance(kind, type) and is_dataclass(kind) and kind is not config.PluginSpec:
        return key, kind
    blocks = [block for part in get_args(kind) if (block := _nested(part, key))]
    if not blocks:
        return None
    many = {tuple: f"{key}.N", dict: f"{key}.NAME"}.get(get_origin(kind), blocks[0][0])
    return many, blocks[0][1]


def _parameters(target: str) -> Iterator[str]:
    yield _parameter_table(_load(target))


def _plugins(group: str) -> Iterator[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name, target in sorted(project["entry-points"][group].items()):
        factory = _load(target)
        yield f"### {name}"
        yield _first(inspect.getdoc(factory))
        yield _parameter_table(factory, PASSED)


def _parameter_table(factory: Any, passed: tuple[str, ...] = ()) -> str:
    types = get_type_hints(factory.__init__, include_extras=True)
    meanings = _documented(factory)
    return _table(("parameter", "type", "default", "meaning"), [
        (f"`{entry.name}`", _type(types[entry.name]), _default(entry.default),
         _meaning(factory, meanings, entry.name))
        for entry in inspect.signature(factory).parameters.values() if entry.name not in passed
    ])  # fmt: skip


def _documented(kind: Any) -> dict[str, str]:
    """Return the texts of fields and parameters of a class and those above it.

    They are in sections Attributes and Args, and in comments beside or above fields.
    """
    found: dict[str, str] = {}
    for cls in reversed(kind.__mro__):
        source = inspect.getsource(cls) if "__dataclass_fields__" in vars(cls) else ""
        for above, name, beside in re.findall(
            r"((?:^    # .*\n)*)^    (\w+): [^#\n]*(?:  # (.*))?$", source, re.M
        ):
            if text := " ".join(f"{above}{beside}".replace("# ", " ").split()):
                found[name] = f"{text[0].upper()}{text[1:]}."
        for text in (cls.__doc__, cls.__dict__.get("__init__", cls).__doc__):
            section = re.search(
                r"(?:Attributes|Args):\n((?:\n| +.*\n?)+)", inspect.cleandoc(text or "")
            )
            entries = re.findall(
                r"^    (\w+): ((?:.|\n(?!    \w))+)", section[1] if section else "", re.M
            )
            found |= {name: " ".join(meaning.split()) for name, meaning in entries}
    return found


def _meaning(kind: Any, meanings: Mapping[str, str], name: str) -> str:
    if name not in meanings:
        raise SystemExit(f"{kind.__module__}.{kind.__qualname__}: document {name!r}")
    return meanings[name]


def _type(kind: Any) -> str:
    """Return the words for a type, with its bounds."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _type(inner[0]) + "".join(_bounds(part) for part in inner[1:])
    if origin is Literal:
        return ", ".join(f"`{part}`" for part in inner)
    if origin in (Union, UnionType):
        kinds = ["null" if part is type(None) else _type(part) for part in inner]
        return " or ".join(dict.fromkeys(kinds))
    if origin in (tuple, Sequence):
        count = "" if len(inner) == 1 or inner[-1] is ... else f"{len(inner)}: "
        return f"list of {count}{_type(inner[-1] if count else inner[0])}"
    if origin in (dict, Mapping) and (entry := _type(inner[1])) not in ("any", "mapping"):
        return f"mapping of names to {entry}"
    return WORDS.get(kind, "mapping")


def _bounds(bounds: object) -> str:
    if not isinstance(bounds, Interval):
        return ""
    # Larger bounds catch mistakes only.
    names = {">": "gt", ">=": "ge", "<": "lt", "<=": "le"}
    limits: list[tuple[str, Any]] = [(sign, getattr(bounds, name)) for sign, name in names.items()]
    kept = [f"{sign} {limit:g}" for sign, limit in limits if limit is not None and abs(limit) < 1e4]
    return f" ({', '.join(kept)})" if kept else ""


def _default(value: object) -> str:
    if value in NO_VALUE:
        return "required"
    plain = json.dumps(config.to_mapping({"": value})[""])
    return (
        f"`{json.dumps(json.loads(plain, parse_float=lambda text: float(f'{float(text):.6g}')))}`"
    )


def _modules(*names: str) -> Iterator[str]:
    for name in names:
        yield f"### {name}"
        tree = ast.parse(Path(str(find_spec(name).origin)).read_text(encoding="utf-8"))  # type: ignore[union-attr]
        yield f"{_first(ast.get_docstring(tree))} [Source](../../{_source(name)})"
        yield _table(("name", "meaning"), list(_members(tree)))


def _source(module: str) -> str:
    folder = module.split(".")
    folder = folder[1:] if folder[1] in SOURCES else folder
    package = Path(str(find_spec(module).origin)).stem == "__init__"  # type: ignore[union-attr]
    return "/".join([*folder, "__init__"] if package else folder) + ".py"


def _members(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the call and the first line of the docstring of each public function and class."""
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        called = node.name
        if isinstance(node, ast.FunctionDef):
            own = node.args
            names = [entry.arg for entry in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
            called += f"({', '.join(names)})"
        yield f"`{called}`", _first(ast.get_docstring(node))


def _first(docstring: str | None) -> str:
    """Return the first paragraph of a docstring in a line."""
    return " ".join((docstring or "").partition("\n\n")[0].split())


def _load(target: str) -> Any:
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def _table(columns: tuple[str, ...], rows: Any) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    if len(lines) == 2:
        return ""
    return "\n".join(f"| {' | '.join(map(_cell, cells))} |" for cells in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


PARTS: dict[str, Callable[..., Iterator[str]]] = {
    "commands": _commands,
    "keys": _keys,
    "parameters": _parameters,
    "plugins": _plugins,
    "modules": _modules,
}

if __name__ == "__main__":
    for page in sorted(PAGES.glob("*.md")):
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
