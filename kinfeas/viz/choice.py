"""What a simulated robot with live targets consists of; quick to import."""

from dataclasses import dataclass

DT = 0.02
"""Control period, seconds."""

NONE = "none"
"""Choice of no second policy and of no scene."""


@dataclass(frozen=True)
class Choice:
    """What the page shows."""

    robot: str  # robot by name or path
    policy: str = "pretrained"  # policy by name or path
    second_policy: str = NONE  # policy of a second robot with the same target, or `none`
    # motion generator; `servo` follows the handle, others start at its release
    generator: str = "servo"
    filters: tuple[str, ...] = ("time_scaling",)  # names of the command filters, in order
    backend: str = "analytic"  # backend by name
    scene: str = "room"  # scene by name or path, or `none`
