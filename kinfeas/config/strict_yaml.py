"""YAML text as plain data, and back.

Scalars are read as in YAML 1.2, not 1.1: `1e-3` is a number, `off` and `2024-01-01` are strings;
`100_000` is a number, too. Anchors, aliases, duplicate keys and tags of Python objects raise an
error.
"""

import re
import sys
from collections.abc import Hashable
from pathlib import Path

import yaml

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_file, reading, write_file

MAX_BYTES = 1_000_000

CODE = re.compile(r"[\w.]+:[\w.]+")
"""Pattern of `module:name`, a class or function that options and programs may name, not files."""

_INT = r"[-+]?(0|[1-9][0-9]*|[1-9][0-9]{0,2}(_[0-9]{3})+)"
_FLOAT = (
    rf"{_INT}|[-+]?(\.[0-9]+|[0-9]+\.[0-9]*)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_SCALARS = {
    "null": (r"~|null|Null|NULL|", "~nN"),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (_INT, "-+0123456789"),
    "float": (_FLOAT, "-+0123456789."),
}


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML's own way to begin without rules

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        # Aliases within aliases grow without bound.
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise yaml.MarkedYAMLError(
                problem="anchors and aliases are not supported", problem_mark=event.start_mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Hashable, object]:
        keys = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise yaml.MarkedYAMLError(
                    problem=f"duplicate key {key.value!r}", problem_mark=key.start_mark
                )
            keys.add(key.value if isinstance(key, yaml.ScalarNode) else key)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers = {}  # noqa: RUF012 - the reader's rules decide what needs quotes


for _class in (_Loader, _Dumper):
    for _kind, (_pattern, _first) in _SCALARS.items():
        _class.add_implicit_resolver(
            f"tag:yaml.org,2002:{_kind}", re.compile(rf"^(?:{_pattern})$"), [*_first, ""]
        )


def parse(text: str, source: str) -> object:
    """Return the plain data of one YAML document."""
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader
    except yaml.MarkedYAMLError as error:
        where = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise KinfeasError(f"{source}: broken YAML{where}: {error.problem}") from error
    # PyYAML raises all of these for the text of tags such as `!!int x` and `!!bool x`.
    except (
        yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, RecursionError,
    ) as error:  # fmt: skip
        raise KinfeasError(f"{source}: broken YAML: {' '.join(str(error).split())}") from error


def to_text(data: object, *, compact: bool = False) -> str:
    """Return plain data as YAML; `compact` gives each innermost collection one line."""
    # Escaped to ASCII, since PyYAML folds some other characters that it writes.
    flow, width = (None, sys.maxsize) if compact else (False, None)
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, width=width)


def to_line(value: object) -> str:
    """Return a value as YAML in one line."""
    text = yaml.dump(value, Dumper=_Dumper, default_flow_style=True, width=sys.maxsize)
    return text.removesuffix("...\n").strip()


def read(path: Path) -> dict[str, object]:
    """Return the mapping of a YAML file; an empty file is an empty mapping."""
    with reading(path):
        text = read_file(path, MAX_BYTES).decode()
    data = parse(text, str(path))
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise KinfeasError(f"{path}: must be a mapping of keys to values")
    _check_runs_no_code(data, path)
    return data


def _check_runs_no_code(data: object, path: Path, generator: bool = False) -> None:
    """Raise KinfeasError if a motion generator, or one in a list of them, matches `CODE`."""
    if isinstance(data, dict):
        for key, value in data.items():
            _check_runs_no_code(value, path, generator or str(key).endswith("generator"))
    elif isinstance(data, list):
        for value in data:
            _check_runs_no_code(value, path, generator)
    elif generator and isinstance(data, str) and CODE.fullmatch(data):
        raise KinfeasError(f"{path}: 'generator': {data!r}: files name installed plugins only")


def write(data: object, path: Path, *, compact: bool = False) -> None:
    """Write plain data as a YAML file that `read` reads back, atomically; as `to_text`."""
    _check_runs_no_code(data, path)
    write_file(path, to_text(data, compact=compact).encode())
