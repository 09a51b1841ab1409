"""Options that stand for settings of the PyBullet world."""

from collections.abc import Mapping, Sequence

from kinfeas.cli import options
from kinfeas.core.errors import KinfeasError


def physics_assignments(
    head_start: float | None,
    time_scale: float | None,
    without_objects: bool,
    overrides: Sequence[str],
) -> list[str]:
    """Return what options and --set say of the PyBullet world, as assignments.

    Args:
        head_start: Seconds; None if not given.
        time_scale: Share of the planned speed; None if not given.
        without_objects: Whether the scene is to be left out.
        overrides: What --set says.

    Raises:
        KinfeasError: If an option is out of range, or --set says something of the same setting.
    """
    from kinfeas.config import assigned
    from kinfeas.envs.world import WorldConfig

    numbers = {
        "--head-start": ("head_start", head_start),
        "--time-scale": ("time_scale", time_scale),
    }
    options.check_settings(WorldConfig, numbers)
    told = {option: entry for option, entry in numbers.items() if entry[1] is not None}
    wishes: dict[str, tuple[str, object]] = dict(told)
    if without_objects:
        wishes["--no-objects"] = ("backend_parameters.objects", False)
    world = assigned(overrides).get("world")
    for option, (key, _) in wishes.items():
        if isinstance(world, Mapping) and key in world:
            raise KinfeasError(f"{option} and --set world.{key} exclude each other")
    return [*(f"world.{key}={value}" for key, value in wishes.values()), *overrides]
