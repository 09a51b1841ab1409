"""Policies by name: the baselines, and trained ones by their folder."""

from collections.abc import Callable
from pathlib import Path

from kinfeas import policy
from kinfeas.baselines.follow_ee import FollowEe
from kinfeas.config import no_such
from kinfeas.errors import KinfeasError
from kinfeas.policy import Policy
from kinfeas.robots.robot import Robot

BASELINES: dict[str, Callable[[Robot], Policy]] = {
    "follow_ee": lambda robot: FollowEe(robot.base),
    "follow_ee_feedback": lambda robot: FollowEe(robot.base, feedback=True),
}
"""Base motions that need no training."""


def load_policy(name: str, robot: Robot) -> Policy:
    """Return a baseline by its name or a trained policy by its run or checkpoint folder.

    Raises:
        KinfeasError: If there is neither, or the trained policy is broken or not for `robot`.
    """
    if name in BASELINES:
        return BASELINES[name](robot)
    if not Path(name).exists():
        raise KinfeasError(
            f"unknown policy {name!r}{no_such(name, BASELINES)}, or the folder of a training run"
        )
    return policy.read_network(Path(name), robot)
