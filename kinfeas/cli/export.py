"""`kinfeas export`: a trained policy as one ONNX file, and checks of such files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_facts, status, write_json
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.policies.onnx_policy import OnnxPolicy


def export(
    policy: Annotated[
        str | None,
        typer.Argument(help="Folder of a training run or of a checkpoint, or pretrained."),
    ] = None,
    out: Annotated[Path | None, options.file_option("File to write.", ".onnx")] = None,
    check: Annotated[
        Path | None, typer.Option(metavar="FILE.onnx", help="Verify this file, write nothing.")
    ] = None,
    robot: options.PolicyRobotName = None,
    json: options.JsonPath = None,
) -> None:
    """Write or verify a policy as ONNX file. The file describes itself.

    The file answers as the training policy does, to 1e-5. It runs with onnxruntime alone, and
    --policy of other commands takes it.

    Example: kinfeas export runs/pr2 --out pr2.onnx

    Example: kinfeas export --check pr2.onnx --robot pr2
    """
    if check is not None and policy is None and out is None:
        _check(check, robot, json)
    elif policy is not None and out is not None and check is None:
        with status("exporting"):
            found, deviation = export_policy(policy, robot, out)
        told = {**facts(found, out), "parity": deviation}
        write_json(told, json)
        _show(f"exported: {out}", told)
    else:
        raise KinfeasError("give POLICY and --out FILE to export, or --check FILE to verify")


def export_policy(policy: str, robot: str | None, out: Path) -> tuple["OnnxPolicy", float]:
    """Write a policy as an ONNX file; return it and its largest deviation from the policy."""
    from kinfeas.policies import pretrained

    if not pretrained.is_shipped(policy) and not Path(policy or "-").is_dir():
        raise KinfeasError(f"POLICY must be a run, a checkpoint or pretrained, not {policy!r}")
    known = options.read_robot(robot or options.robot_of(policy))
    from kinfeas.policies.export import export as run

    return run(pretrained.folder(known.name, policy), known, out)


def _check(path: Path, robot: str | None, json: Path | None) -> None:
    from kinfeas.policies.onnx_policy import read_policy_file

    found = read_policy_file(path, None if robot is None else options.read_robot(robot))
    write_json(facts(found, path), json)
    compared = f"kinematics equal to {robot}" if robot else "kinematics not compared: no --robot"
    _show(f"valid policy file: {path}, {compared}", facts(found, path))


def facts(policy: "OnnxPolicy", path: Path) -> dict[str, Any]:
    """Return the metadata of a policy file at `path`."""
    from kinfeas.config import to_mapping

    return {"file": path.name, "bytes": path.stat().st_size, **to_mapping(policy.metadata)}


def _show(title: str, found: dict[str, Any]) -> None:
    """Print the metadata without settings of the training and golden pairs."""
    shown = {key: value for key, value in found.items() if key not in ("training", "golden")}
    for terms in ("observation", "action"):
        shown[terms] = [{k: v for k, v in term.items() if v != []} for term in found[terms]]
    print_facts(title, shown)
