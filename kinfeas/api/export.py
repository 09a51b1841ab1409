"""Trained policies as ONNX files, and checks of such files."""

from dataclasses import dataclass
from pathlib import Path

from kinfeas.api import Name
from kinfeas.api.load import load_robot, robot_of
from kinfeas.config import to_mapping
from kinfeas.core.errors import KinfeasError
from kinfeas.policies.loading import trained_folder
from kinfeas.policies.onnx_policy import OnnxPolicy, PolicyMetadata, read_policy_file


@dataclass(frozen=True)
class PolicyFile:
    """An exported policy.

    Attributes:
        path: Its file.
        bytes: Size of the file.
        metadata: Description of the policy.
        parity: Largest deviation of its actions from the trained policy's; None if not measured.
    """

    path: Path
    bytes: int
    metadata: PolicyMetadata
    parity: float | None = None

    def facts(self) -> dict[str, object]:
        """Return the description as plain data."""
        parity = {} if self.parity is None else {"parity": self.parity}
        return {"file": self.path.name, "bytes": self.bytes, **to_mapping(self.metadata), **parity}


def export(policy: Name, out: Name, *, robot: Name | None = None) -> PolicyFile:
    """Write a trained policy as an ONNX file and return its description.

    Example: `kinfeas.export("runs/pr2", "pr2.onnx").parity`

    The policy is a run, a checkpoint or `pretrained`.

    Raises:
        KinfeasError: If the policy is not a trained one or for another robot, or the file cannot
            be written.
    """
    name, path = str(policy), Path(out)
    if path.suffix != ".onnx":
        raise KinfeasError(f"{path}: must end in .onnx")
    model = load_robot(robot or robot_of(name))
    folder = trained_folder(name, model)
    if not name or not folder.is_dir():
        raise KinfeasError(f"policy {name!r} is not a run, a checkpoint or pretrained")
    from kinfeas.policies.export import export as run

    return _file(path, *run(folder, model, path))


def check_export(path: Name, *, robot: Name | None = None) -> PolicyFile:
    """Return the description of a valid ONNX file, compared with the kinematics of a robot.

    Raises:
        KinfeasError: If the file is no valid policy, or for another robot.
    """
    model = None if robot is None else load_robot(robot)
    return _file(Path(path), read_policy_file(Path(path), model))


def _file(path: Path, policy: OnnxPolicy, parity: float | None = None) -> PolicyFile:
    return PolicyFile(path, path.stat().st_size, policy.metadata, parity)
