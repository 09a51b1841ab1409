"""Policies by name: entry points, trained policies of a robot, and files."""

from pathlib import Path

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.policy import Policy
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import read_policy_file
from kinfeas.robots.robot import Robot

GROUP = "kinfeas.policies"

PRETRAINED = "pretrained"
"""Name of the policy in a robot's folder that is used by default."""

QUICK_BASELINES = ("follow_ee", "follow_ee_feedback")
"""Baselines without set-up time and extra packages, for comparisons."""


def trained_policies(robot: Robot) -> list[str]:
    """Return the sorted names of the trained policies in the folder of a robot."""
    folder, best = robot.folder / "policies", "checkpoints/best/policy.json"  # of a training run
    files = *folder.glob("*/policy.json"), *folder.glob(f"*/{best}")
    return sorted({path.relative_to(folder).parts[0] for path in files})


def trained_folder(name: str, robot: Robot) -> Path:
    """Return the folder of a trained policy: a name of `trained_policies`, or a path.

    Raises:
        KinfeasError: If `name` is `pretrained`, and the robot has no such policy.
    """
    folder = robot.folder / "policies" / name
    if name == PRETRAINED and not folder.is_dir():
        raise KinfeasError(
            f"{folder}: no such policy; train one with kinfeas train, or take a baseline: planner"
        )
    return folder if name in (PRETRAINED, *trained_policies(robot)) else Path(name)


def load_policy(name: str, robot: Robot) -> Policy:
    """Return a policy for a robot.

    Args:
        name: Entry point in the group `kinfeas.policies`, such as `follow_ee`; trained policy in
            the robot's folder, such as `pretrained`; `module:Class`, called with the keyword
            argument `robot` and also searched for in the working directory; folder of a training
            run or checkpoint; or exported ONNX file.
        robot: Robot that the policy is to command.

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    plugins = registry.names(GROUP)
    if name not in plugins:
        path = trained_folder(name, robot)
        if name and path.is_dir():
            return read_network(path, robot)
        if path.suffix == ".onnx" or path.is_file():
            return read_policy_file(path, robot)
        if ":" not in name:
            names = (*plugins, PRETRAINED, *trained_policies(robot))
            raise KinfeasError(
                f"unknown policy {name!r}{no_such(name, names)}, or the folder of a training run, "
                "an exported ONNX file, or module:Class"
            )
    return registry.build(GROUP, name, {"robot": robot})
