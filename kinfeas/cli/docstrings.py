"""What a Google docstring says: its summary, and each parameter with its unit."""

import inspect
import re
from dataclasses import dataclass

_SECTION = re.compile(
    r"^(Args|Attributes|Raises|Returns|Yields|Example|Examples|Note|Notes):\s*$", re.MULTILINE
)
_ENTRY = re.compile(r"^ {4}(\*{0,2}\w+)(?: \([^)]*\))?: *(.*)$")

# A line break within a paragraph or an item of a list, with what the next line is indented by.
_WRAP = re.compile(r"(?<!\n)\n(?!\n| *(?:[-*]|\d+\.) ) *")

_SYMBOLS = (
    "m/s^3",
    "rad/s^3",
    "m/s^2",
    "rad/s^2",
    "rad/s",
    "m/s",
    "1/s",
    "N m",
    "m",
    "rad",
    "s",
    "Hz",
    "kg",
)
_WORDS = {
    "metres": "m",
    "metre": "m",
    "radians": "rad",
    "degrees": "deg",
    "milliseconds": "ms",
    "seconds": "s",
    "second": "s",
}
# What stands in prose, and the symbol of it; the first that is found in a description counts.
_UNITS = {symbol: symbol for symbol in _SYMBOLS} | _WORDS
_UNITS |= {word.capitalize(): symbol for word, symbol in _WORDS.items()}
_LONGEST_FIRST = "|".join(map(re.escape, sorted(_UNITS, key=len, reverse=True)))
# A lone letter is a unit only where prose puts one: "in m", "length, m".
_UNIT = re.compile(rf"(?:(?<=in )|(?<=, )|(?<![\w/'])(?=[\w/^ ]{{2}}))({_LONGEST_FIRST})(?![\w/^])")


@dataclass(frozen=True)
class Docstring:
    """What a docstring says.

    Attributes:
        summary: Its first line.
        text: All that stands before the first section, the summary included.
        entries: What `Args` and `Attributes` say, on one line each, by name.
    """

    summary: str
    text: str
    entries: dict[str, str]


def read_docstring(documented: object) -> Docstring:
    """Return what a class or function says of itself; a class together with its constructor."""
    own = inspect.cleandoc(getattr(documented, "__doc__", None) or "")
    text, entries = _parts(own)
    if isinstance(documented, type):
        initialiser = inspect.getattr_static(documented, "__init__")
        constructor = inspect.cleandoc(initialiser.__doc__ or "")
        entries = {**_parts(constructor)[1], **entries}
    return Docstring(text.partition("\n")[0].strip(), text, entries)


def unwrapped(documented: object) -> str:
    """Return a docstring with each paragraph and each item of a list on a line of its own.

    For help: what shows it would keep the line breaks and add its own.
    """
    return _WRAP.sub(" ", inspect.cleandoc(getattr(documented, "__doc__", None) or ""))


def unit(description: str) -> str:
    """Return the symbol of the unit that a description names first, or nothing."""
    found = _UNIT.search(description)
    return _UNITS[found.group(1)] if found else ""


def _parts(text: str) -> tuple[str, dict[str, str]]:
    """Return what stands before the sections, and the entries of those that describe names."""
    pieces = _SECTION.split(text)
    entries: dict[str, str] = {}
    for title, body in zip(pieces[1::2], pieces[2::2], strict=True):
        if title in ("Args", "Attributes"):
            entries |= _entries(body)
    return pieces[0].strip(), entries


def _entries(body: str) -> dict[str, str]:
    entries: dict[str, str] = {}
    name = ""
    for line in body.splitlines():
        if line.strip() and not line.startswith(" "):
            break  # prose goes on after the section
        begins = _ENTRY.match(line)
        if begins:
            name = begins.group(1).lstrip("*")
            entries[name] = begins.group(2).strip()
        elif name and line.strip():
            entries[name] = f"{entries[name]} {line.strip()}".strip()
    return entries
