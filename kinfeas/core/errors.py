"""The error of wrong input."""

import difflib
from collections.abc import Collection


class KinfeasError(ValueError):
    """Bad input: a file, key, value, URDF, plugin or policy.

    The message is one sentence that names what is wrong and what is allowed. The command line
    prints it without a traceback and exits with code 2.
    """


def no_such(word: str, names: Collection[str]) -> str:
    """Return the end of an error on the unknown `word`: a guess, and the `names` that exist."""
    close = difflib.get_close_matches(word, names, n=1)
    guess = f" (did you mean {close[0]!r}?)" if close else ""
    return f"{guess}; known are {', '.join(sorted(names)) or 'none'}"
