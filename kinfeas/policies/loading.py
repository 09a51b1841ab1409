"""Policies by name: entry points, trained policies and exported files."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.policies import pretrained

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.robots.robot import Robot

GROUP = "kinfeas.policies"

BASELINES = (
    "follow_ee",
    "follow_ee_feedback",
    "demonstrated_base",
    "geometric_modulation",
    "whole_body_qp",
)
"""Entry points of the package: base motions without training."""

QUICK_BASELINES = ("follow_ee", "follow_ee_feedback")
"""Baselines without set-up time and extra packages, for comparisons."""


def load_policy(name: str, robot: "Robot") -> "Policy":
    """Return a policy for a robot.

    Args:
        name: Entry point in the group `kinfeas.policies`, such as `follow_ee`; `pretrained`;
            `module:Class`, called with the keyword argument `robot`; folder of a training run or
            checkpoint; or exported ONNX file.
        robot: Robot that the policy is to command.

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    check_name(name)
    if name in registry.names(GROUP):
        policy: Policy = registry.build(GROUP, name, {"robot": robot})
        return policy
    path = pretrained.find(robot.name) if name == pretrained.NAME else Path(name)
    if not path.exists():
        return _from_module(name, robot)
    if path.is_dir():
        from kinfeas.policies.network import read_network

        return read_network(path, robot)
    from kinfeas.policies.onnx_policy import read_policy_file

    return read_policy_file(path, robot)


def check_name(name: str) -> None:
    """Check without imports that a policy of this name may exist."""
    known = (*registry.names(GROUP), pretrained.NAME)
    path = Path(name)
    if name in known or (name and (path.is_dir() or path.is_file())) or _is_target(name):
        return
    raise KinfeasError(
        f"unknown policy {name!r}{no_such(name, known)}, "
        "or the folder of a training run, an exported ONNX file, or module:Class"
    )


def _is_target(name: str) -> bool:
    module, colon, attribute = name.partition(":")
    parts = (*module.split("."), *attribute.split("."))
    return bool(colon) and all(part.isidentifier() for part in parts)


def _from_module(target: str, robot: "Robot") -> "Policy":
    """Return the policy `module:Class` for the robot; searches the working directory, too."""
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    policy: Policy = registry.build_target(GROUP, target, {"robot": robot})
    return policy
