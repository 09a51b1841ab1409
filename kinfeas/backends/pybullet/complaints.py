"""What PyBullet says of a URDF while it loads it, made fit for a sentence."""

import re

_HARMLESS = re.compile(
    r"^(No inertial data for link|Bad inertia tensor properties|urdfdom: no axis element)"
)
_HEAD = re.compile(r"b3(Error|Warning|Printf)\[[^\]]*\]:")
_PLACE = re.compile(r"^.*\.urdf:\d+: ")
_OUTCOME = "Could not parse"
_UNREAD = re.compile(
    r"cannot extract (?:mesh|anything useful) from (?:mesh )?'(.+)'"
    r"|issue extracting mesh from COLLADA/STL file (.+)"
)


def complaint(heard: str) -> str:
    """Return why PyBullet cannot load a URDF, in one line; nothing if it does not say so.

    That is its first error, or what it said before, if this only says what could not be parsed.
    """
    parts = _HEAD.split(heard)
    said = [" ".join(words.split()) for words in parts[2::2]]
    errors = [number for number, kind in enumerate(parts[1::2]) if kind == "Error"]
    if not errors:
        return ""
    first = errors[0]
    told = said[first].startswith(_OUTCOME) and first > 0
    return _PLACE.sub("", said[first - 1] if told else said[first])


def unread_mesh(heard: str) -> str | None:
    """Return the first mesh in which PyBullet found nothing, if there is one."""
    found = _UNREAD.search(heard)
    return found and (found[1] or found[2])


def remarks(heard: str) -> str:
    """Return what PyBullet said of a URDF of a scene, but for what has no consequence.

    Links that can move have been checked to have an inertia; others need none. A joint without an
    axis moves along x, as URDFs have it.
    """
    parts = _HEAD.split(heard)
    kept, harmless = [parts[0]], False
    for kind, words in zip(parts[1::2], parts[2::2], strict=True):
        said = words.strip()
        # A warning may come in two parts: what is wrong, and the name of the link.
        harmless = bool(_HARMLESS.match(said)) or (harmless and " " not in said)
        if not harmless:
            kept.append(f"{kind}: {said}\n")
    return "".join(kept)
