"""YAML text as plain data, and back: the safe and unsurprising part of the language.

Read as in YAML 1.2, not 1.1: `1e-3` is a number, `off` and `2024-01-01` are strings; but for
`100_000`, whose groups of three digits may be told apart. Anchors, aliases, duplicate keys and tags
other than those of plain data are refused.
"""

import re
import sys
from collections.abc import Hashable
from pathlib import Path

import yaml

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import read_file, reading, write_file

MAX_BYTES = 1_000_000
"""More than any file written by hand; it keeps a wrong path from filling the memory."""

# What PyYAML raises on text that fits no type, such as `!!int x`, `!!bool x` or `!!timestamp x`.
_BROKEN = (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, RecursionError)


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers = {}  # noqa: RUF012 - PyYAML's own way to begin without rules

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        # An alias within an alias within an alias grows without bound in whatever walks it.
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            problem = "anchors (&name) and aliases (*name) are not allowed"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        node = super().compose_node(parent, index)
        if node is not None and event.tag is not None:
            _check_tag(node)
        return node

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Hashable, object]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"the key {key.value!r} stands there twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else key)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers = {}  # noqa: RUF012 - the reader's rules decide what needs quotes


_STANDARD = "tag:yaml.org,2002:"
_INT = r"[-+]?(0|[1-9][0-9]*|[1-9][0-9]{0,2}(_[0-9]{3})+)"
_RULES = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (_INT, list("-+0123456789")),
    "float": (
        rf"{_INT}|[-+]?(\.[0-9]+|[0-9]+\.[0-9]*)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+0123456789."),
    ),
}
_KINDS = {f"{_STANDARD}{_name}": _name for _name in ("map", "seq", "str", *_RULES)}
for _class in (_Loader, _Dumper):
    for _name, (_pattern, _first) in _RULES.items():
        _tag = f"{_STANDARD}{_name}"
        _class.add_implicit_resolver(_tag, re.compile(rf"^(?:{_pattern})$"), _first)


def _check_tag(node: yaml.Node) -> None:
    """Raise unless a tag that was written is one of plain data, and its text is of that kind."""
    kind = _KINDS.get(node.tag)
    if kind is None:
        allowed = ", ".join(f"!!{one}" for one in _KINDS.values())
        problem = f"could not determine a constructor for the tag {node.tag!r}; allowed: {allowed}"
    elif kind in _RULES and not re.fullmatch(_RULES[kind][0], str(node.value)):
        problem = f"{node.value!r} is no {kind}"
    else:
        return
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


def parse(text: str, source: str) -> object:
    """Return the plain data that the YAML `text` stands for.

    Args:
        text: One YAML document.
        source: Where the text is from, for the error.

    Raises:
        KinfeasError: If `text` is not YAML, with the line.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        where = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise KinfeasError(f"{source}: broken YAML{where}: {error.problem}") from error
    except RecursionError as error:
        raise KinfeasError(f"{source}: broken YAML: nested too deeply") from error
    except _BROKEN as error:
        reason = " ".join(str(error).split())
        raise KinfeasError(f"{source}: broken YAML: {reason}") from error


def read(path: Path) -> dict[str, object]:
    """Return the mapping that the YAML file `path` holds; an empty file is an empty mapping.

    Raises:
        KinfeasError: If the file cannot be read, is too large or does not hold a mapping.
    """
    with reading(path):
        text = read_file(path, MAX_BYTES).decode()
    data = parse(text, str(path))
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise KinfeasError(f"{path}: must hold a mapping of keys to values")
    return data


def write(data: object, path: Path, *, compact: bool = False) -> None:
    """Write plain data as a YAML file that `read` reads back, all of it or nothing.

    Args:
        data: Nested mappings and lists of plain values.
        path: File to write.
        compact: Put each innermost mapping and list on a line of its own, as for matrices.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    # Escaped to ASCII by default, for PyYAML folds some other characters that it writes.
    flow, width = (None, sys.maxsize) if compact else (False, None)
    text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, width=width)
    write_file(path, text.encode())
