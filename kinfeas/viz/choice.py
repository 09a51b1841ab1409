"""What a simulated robot with live targets consists of; quick to import."""

from dataclasses import dataclass

DT = 0.02
"""Control period, seconds."""

NONE = "none"
"""Choice of no second policy and of no scene."""


@dataclass(frozen=True)
class Choice:
    """What the page shows.

    Attributes:
        robot: Robot by name or path.
        policy: Policy by name or path.
        second_policy: Policy of a second robot with the same target, or `none`.
        generator: Motion generator; `servo` follows the handle, others start at its release.
        filters: Names of the command filters, in order.
        backend: Backend by name.
        scene: Scene by name or path, or `none`.
    """

    robot: str
    policy: str = "pretrained"
    second_policy: str = NONE
    generator: str = "servo"
    filters: tuple[str, ...] = ("time_scaling",)
    backend: str = "analytic"
    scene: str = "room"
