"""Trained policies that the package ships: `pretrained` of each robot, and `pretrained/rooms`.

Each has `policy.safetensors` and `policy.json`, with configuration, seed, figures and the command
that made it. `kinfeas benchmark` writes such folders as `OUT/pretrained`.
"""

from pathlib import Path

from kinfeas.core.errors import KinfeasError

NAME = "pretrained"
"""Name of the shipped policy of a robot; others have names below it."""

_ROOT = Path(__file__).parent


def robots() -> list[str]:
    """Return the sorted names of the robots with a shipped policy."""
    return sorted(path.parent.name for path in _ROOT.glob("*/policy.json"))


def is_shipped(name: str) -> bool:
    """Return whether a policy's name is that of a shipped one."""
    return name.partition("/")[0] == NAME


def folder(robot: str, policy: str) -> Path:
    """Return the folder of a policy: a robot's shipped one, or a path."""
    return find(robot, policy) if is_shipped(policy) else Path(policy)


def find(robot: str, name: str = NAME) -> Path:
    """Return the folder of a robot's shipped policy of this name."""
    kind = name.removeprefix(NAME).removeprefix("/")
    if kind and kind.isidentifier() and (_ROOT / robot / kind / "policy.json").is_file():
        return _ROOT / robot / kind
    if kind:
        known = [f"{NAME}/{path.parent.name}" for path in (_ROOT / robot).glob("*/policy.json")]
        names = ", ".join([NAME, *sorted(known)])
        here = f"; the folder is ./{name}" if Path(name).is_dir() else ""
        raise KinfeasError(f"no policy {name!r} for robot {robot!r}, only: {names}{here}")
    if robot not in robots():
        raise KinfeasError(
            f"no pretrained policy for robot {robot!r}, only for: {', '.join(robots())}; "
            "train one with kinfeas train"
        )
    return _ROOT / robot
