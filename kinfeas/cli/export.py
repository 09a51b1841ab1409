"""`kinfeas export`: a trained policy as one ONNX file, and checks of such files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, share, status, write_json
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.policies.onnx_policy import OnnxPolicy, PolicyMetadata


def export(
    policy: Annotated[
        str | None,
        typer.Argument(help="Folder of a training run or of a checkpoint, or pretrained."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.onnx",
            help="File to write.",
            callback=options.output_file(".onnx"),
        ),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option("--check", metavar="FILE.onnx", help="Verify this file, write nothing."),
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
        write_json({**facts(found, out), "parity": deviation}, json)
        size = ["size", f"{out.stat().st_size:,} bytes"]
        _show(f"exported: {out}", found, [size, ["largest deviation", f"{deviation:.1e}"]])
    else:
        raise KinfeasError("give POLICY and --out FILE to export, or --check FILE to verify")


def export_policy(policy: str, robot: str | None, out: Path) -> tuple["OnnxPolicy", float]:
    """Write a policy as an ONNX file; return it and its largest deviation from the policy.

    Raises:
        KinfeasError: If it is no trained policy, not for the robot, or cannot be written.
    """
    from kinfeas.policies import pretrained

    if policy != pretrained.NAME and not Path(policy or "-").is_dir():
        raise KinfeasError(f"POLICY must be a run, a checkpoint or pretrained, not {policy!r}")
    known = options.read_robot(robot or options.robot_of(policy))
    from kinfeas.sim2real.export import export as run

    folder = pretrained.find(known.name) if policy == pretrained.NAME else Path(policy)
    return run(folder, known, out)


def _check(path: Path, robot: str | None, json: Path | None) -> None:
    from kinfeas.policies.loading import check_name
    from kinfeas.policies.onnx_policy import read_policy_file

    check_name(str(path))
    found = read_policy_file(path, None if robot is None else options.read_robot(robot))
    write_json(facts(found, path), json)
    compared = f"equal to those of {robot}" if robot else "not compared: no --robot"
    _show(f"valid policy file: {path}", found, [["its kinematics", compared]])


def facts(policy: "OnnxPolicy", path: Path) -> dict[str, object]:
    """Return the metadata of a policy file at `path`."""
    from kinfeas.config import to_mapping

    return {"file": path.name, "bytes": path.stat().st_size, **to_mapping(policy.metadata)}


def _show(title: str, policy: "OnnxPolicy", first: list[list[str]]) -> None:
    about = policy.metadata
    robot, control = about.robot, about.control
    rows = [
        *first,
        ["written by", f"kinfeas {about.version}"],
        ["robot", f"{robot.name}, {robot.drive}"],
        ["kinematics", f"{robot.kinematics[:23]}..."],
        ["EE frame", robot.ee_frame],
        ["base frame", robot.base_frame],
        [
            "control period in training",
            "unknown" if control.period is None else f"{control.period:g} s",
        ],
        ["horizon of the planned motion", f"{control.horizon:g} s"],
        *_training_rows(about),
        ["golden pairs", str(len(about.golden.action))],
    ]
    print_table(title, ["", "value"], rows)
    print_table("observation", [" number", "field", "frame", "unit"], _observation_rows(about))
    actions = [
        [str(i), f"{term.name} {name}", f"{scale:g}", term.unit]
        for term in about.action
        for i, (name, scale) in enumerate(zip(term.entries, term.scale, strict=True))
    ]
    print_table("action, in [-1, 1]", [" number", "term", "scale", "unit"], actions)


def _observation_rows(about: "PolicyMetadata") -> list[list[str]]:
    first, rows = 0, []
    for term in about.observation:
        last = first + term.size - 1
        numbers = str(first) if first == last else f"{first}-{last}"
        rows.append([numbers, term.name, term.frame, term.unit])
        first += term.size
    return rows


def _training_rows(about: "PolicyMetadata") -> list[list[str]]:
    config, steps = about.training.get("config"), about.training.get("steps")
    rows = []
    if isinstance(config, dict):
        rows.append(["trained for the task", str(config.get("task"))])
    if isinstance(steps, int):
        rows.append(["steps of training", f"{steps:,}"])
    benchmark = about.success.get("benchmark")
    figures = {"evaluation": about.success.get("evaluation")}
    figures |= benchmark if isinstance(benchmark, dict) else {}
    for name, found in figures.items():
        if isinstance(found, dict) and isinstance(found.get("success"), float):
            text = f"{share(found['success'])} of {found.get('episodes')} episodes"
            rows.append([f"success, {name}", text])
    return rows
