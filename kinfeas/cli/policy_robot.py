"""The policy that is asked for, and the robot that moves where no other is named: its own."""

from pathlib import Path

from kinfeas.cli import completion
from kinfeas.core.errors import KinfeasError

DEFAULT = "pr2"


def check_policy(policy: str) -> None:
    """Check that what `--policy` names is there, before anything slow is imported.

    Raises:
        KinfeasError: If it is not.
    """
    from kinfeas.policies.loading import check_name

    check_name(policy)


def robot_of(policy: str | None) -> str:
    """Return the robot that a policy was trained for, by name or by the path of its YAML.

    It is `DEFAULT` for what can drive any robot, and for what is no policy at all.

    Args:
        policy: As an option names it; None if it names none.

    Raises:
        KinfeasError: If a run or a file is broken, or its robot is not on this machine.
    """
    name = policy or ""
    if name in ("", *completion.POLICIES) or not Path(name).exists():
        return DEFAULT
    robot = _trained_with(Path(name))
    if _is_missing(robot):
        raise KinfeasError(
            f"{name}: a policy for the robot of {robot}, which is not there: "
            "name the YAML of the robot with --robot"
        )
    return robot


def _trained_with(path: Path) -> str:
    from kinfeas.io.policy_metadata import read_trained
    from kinfeas.policies.loading import check_name
    from kinfeas.policies.onnx_policy import read_policy_file

    check_name(str(path))
    trained = read_trained(path) if path.is_dir() else read_policy_file(path, None).metadata
    return trained.trained_with


def _is_missing(robot: str) -> bool:
    from kinfeas.io.files import is_path

    return is_path(robot) and not Path(robot).is_file()
