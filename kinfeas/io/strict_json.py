"""JSON files as plain data, of a size and a depth that nothing which walks them chokes on."""

import json
from pathlib import Path

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import read_file, reading

MAX_BYTES = 1_000_000
"""More than any file that is read whole; it keeps a wrong path from filling the memory."""

DEEPEST = 100
"""Lists and mappings within each other, at most."""


def read(path: Path) -> dict[str, object]:
    """Return the mapping that the JSON file `path` holds.

    As Python writes them, its numbers may be `Infinity` and `NaN`, which JSON by itself lacks.

    Raises:
        KinfeasError: If the file cannot be read, is too large, is no JSON or one that is nested
            too deeply, or does not hold a mapping.
    """
    with reading(path):
        text = read_file(path, MAX_BYTES).decode()
    try:
        data = json.loads(text)
        if _depth(data) > DEEPEST:
            raise RecursionError  # as the parser does of what is deeper still
    except RecursionError as error:
        raise KinfeasError(f"{path}: broken JSON: nested too deeply") from error
    except ValueError as error:
        raise KinfeasError(f"{path}: broken JSON: {error}") from error
    if not isinstance(data, dict):
        raise KinfeasError(f"{path}: must hold a mapping of keys to values")
    return data


def _depth(data: object) -> int:
    """Return how many lists and mappings stand within each other."""
    depth, level = 0, [data]
    while level := [one for one in level if isinstance(one, dict | list)]:
        depth += 1
        level = [x for one in level for x in (one.values() if isinstance(one, dict) else one)]
    return depth
