"""Policies by name: entry points, trained policies and exported files."""

import sys
from pathlib import Path

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.policy import Policy
from kinfeas.policies import pretrained
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import read_policy_file
from kinfeas.robots.robot import Robot

GROUP = "kinfeas.policies"

BASELINES = (
    "follow_ee",
    "follow_ee_feedback",
    "demonstrated_base",
    "planned_base",
    "geometric_modulation",
    "whole_body_qp",
)
"""Entry points of the package: base motions without training, but for `stationary`."""

QUICK_BASELINES = ("follow_ee", "follow_ee_feedback")
"""Baselines without set-up time and extra packages, for comparisons."""


def load_policy(name: str, robot: Robot) -> Policy:
    """Return a policy for a robot.

    Args:
        name: Entry point in the group `kinfeas.policies`, such as `follow_ee`; `pretrained` or
            `pretrained/rooms`; `module:Class`, called with the keyword argument `robot` and also
            searched for in the working directory; folder of a training run or checkpoint; or
            exported ONNX file.
        robot: Robot that the policy is to command.

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    if name in registry.names(GROUP):
        policy: Policy = registry.build(GROUP, name, {"robot": robot})
        return policy
    path = pretrained.folder(robot.name, name)
    if name and path.is_dir():
        return read_network(path, robot)
    if path.suffix == ".onnx" or path.is_file():
        return read_policy_file(path, robot)
    module, _, attribute = name.partition(":")
    if not all(part.isidentifier() for part in (*module.split("."), *attribute.split("."))):
        known = no_such(name, (*registry.names(GROUP), pretrained.NAME))
        raise KinfeasError(
            f"unknown policy {name!r}{known}, or the folder of a training run, an exported ONNX "
            "file, or module:Class"
        )
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    policy = registry.build_target(GROUP, name, {"robot": robot})
    return policy
