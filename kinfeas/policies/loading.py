"""Policies by name: the baselines, and trained ones by their folder."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.policies import pretrained

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.robots.robot import Robot


# Each is imported when it is asked for: a deployed policy needs none of them.
def _follow_ee(robot: "Robot") -> "Policy":
    from kinfeas.policies.baselines.follow_ee import FollowEe

    return FollowEe(robot.base)


def _follow_ee_feedback(robot: "Robot") -> "Policy":
    from kinfeas.policies.baselines.follow_ee import FollowEe

    return FollowEe(robot.base, feedback=True)


def _demonstrated_base(robot: "Robot") -> "Policy":
    from kinfeas.policies.baselines.demonstrated_base import demonstrated_base

    return demonstrated_base(robot)


def _geometric_modulation(robot: "Robot") -> "Policy":
    from kinfeas.policies.baselines.geometric_modulation import geometric_modulation

    return geometric_modulation(robot)


def _whole_body_qp(robot: "Robot") -> "Policy":
    from kinfeas.policies.baselines.whole_body_qp import whole_body_qp

    return whole_body_qp(robot)


BASELINES: "dict[str, Callable[[Robot], Policy]]" = {
    "follow_ee": _follow_ee,
    "follow_ee_feedback": _follow_ee_feedback,
    "demonstrated_base": _demonstrated_base,
    "geometric_modulation": _geometric_modulation,
    "whole_body_qp": _whole_body_qp,
}
"""Base motions that need no training."""

QUICK_BASELINES = ("follow_ee", "follow_ee_feedback")
"""Those that a trained policy is always set beside: they cost nothing and need no extra."""


def load_policy(name: str, robot: "Robot") -> "Policy":
    """Return a baseline by its name, or a trained policy by its folder or its ONNX file.

    `pretrained` is the policy that comes with the package for `robot`.

    Raises:
        KinfeasError: If there is none, or the trained policy is broken or not for `robot`.
    """
    check_name(name)
    if name in BASELINES:
        return BASELINES[name](robot)
    from kinfeas.policies.network import read_network

    if name == pretrained.NAME:
        return read_network(pretrained.find(robot.name), robot)
    check_place(Path(name))
    if Path(name).is_file():
        from kinfeas.policies.onnx_policy import read_policy_file

        return read_policy_file(Path(name), robot)
    return read_network(Path(name), robot)


def check_name(name: str) -> None:
    """Check that there is a policy of this name, or something in its place, at once.

    Raises:
        KinfeasError: If there is not.
    """
    known = (*BASELINES, pretrained.NAME)
    if name in known or (name and Path(name).exists()):  # an empty path is the folder one is in
        return
    problem = f"unknown policy {name!r}" if name else "the name of the policy is empty"
    raise KinfeasError(
        f"{problem}{no_such(name, known)}, "
        "or the folder of a training run, or the ONNX file of an export"
    )


def check_place(path: Path) -> None:
    """Check that a policy can be at `path`: a folder, or a file with something in it.

    Raises:
        KinfeasError: If it cannot.
    """
    if path.exists() and not path.is_dir() and not path.is_file():
        raise KinfeasError(
            f"{path}: neither the folder of a training run nor the ONNX file of an export"
        )
    if path.is_file() and path.stat().st_size == 0:
        raise KinfeasError(f"{path}: empty, and so not the ONNX file of an export")
