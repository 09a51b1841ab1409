"""`kinfeas export`: a trained policy as one file, and a look at such a file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import completion, inputs, options
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    check_suffix,
    print_table,
    share,
    status,
    write_json,
)
from kinfeas.cli.policy_robot import robot_of
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.policies.onnx_policy import OnnxPolicy, PolicyMetadata
    from kinfeas.robots.robot import Robot


def export(
    policy: Annotated[
        str | None,
        typer.Argument(
            help="Folder of a training run or of one checkpoint, or pretrained.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="ONNX file to write, such as pr2.onnx.",
            show_default=False,
            callback=check_file_path,
        ),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Write nothing: verify this ONNX file.", show_default=False),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            help=f"{options.ROBOT_HELP[:-1]}; what is not for it is refused. By default the one "
            "that the run was trained for; with pretrained pr2.",
            autocompletion=completion.plugins("robots"),
        ),
    ] = None,
    json: options.JsonPath = None,
) -> None:
    """Write a policy as one ONNX file that describes itself, or verify such a file.

    The file acts as the training policy does, to 1e-5, or is not written. It runs wherever
    onnxruntime does, and [bold]--policy[/] takes it.
    """
    if (check is None) == (policy is None) or (check is None) != (out is not None):
        raise KinfeasError("give a policy and --out FILE to export, or --check FILE to verify one")
    sources = {"POLICY": inputs.of_policy(policy), "--check": inputs.named(check)}
    check_outputs({"--out": out, "--json": json}, {**sources, "--robot": inputs.named(robot)})
    if out is not None:
        check_suffix("--out", out, ".onnx")
    if check is not None:
        _check(check, options.read_robot(robot) if robot else None, json)
    elif policy is not None and out is not None:
        _export(policy, robot, out, json)


def _check(path: Path, robot: "Robot | None", json: Path | None) -> None:
    from kinfeas.policies.loading import check_name
    from kinfeas.policies.onnx_policy import read_policy_file

    check_name(str(path))
    found = read_policy_file(path, robot)
    if json is not None:
        write_json(facts(found, path), json)
    compared = f"those of {robot.name} here" if robot else "not compared, for want of --robot"
    _show(f"policy file {path}: in order", found, [["its kinematics", compared]])


def export_policy(policy: str, robot: str | None, out: Path) -> tuple["OnnxPolicy", float]:
    """Write a policy into an ONNX file; return it, and how far it is off the training policy.

    Raises:
        KinfeasError: If it is no trained policy, not for the robot, or cannot be written.
    """
    from kinfeas.policies import pretrained
    from kinfeas.policies.loading import BASELINES

    folder = Path(policy)
    if policy in ("", *BASELINES) or (policy != pretrained.NAME and not folder.is_dir()):
        raise KinfeasError(
            f"{policy or repr(policy)}: not the folder of a training run or of a checkpoint, nor "
            f"{pretrained.NAME!r}; nothing else can be exported"
        )
    known = options.read_robot(robot or robot_of(policy))
    from kinfeas.sim2real.export import export as run

    if policy == pretrained.NAME:
        folder = pretrained.find(known.name)
    return run(folder, known, out)


def _export(policy: str, robot: str | None, out: Path, json: Path | None) -> None:
    with status("exporting"):
        found, off = export_policy(policy, robot, out)
    if json is not None:
        write_json({**facts(found, out), "parity": off}, json)
    size = ["size", f"{out.stat().st_size:,} bytes"]
    _show(f"exported: {out}", found, [size, ["off the training policy, at most", f"{off:.1e}"]])


def facts(policy: "OnnxPolicy", path: Path) -> dict[str, object]:
    """Return what a policy file at `path` tells of itself."""
    from kinfeas.config import to_mapping

    return {"file": path.name, "bytes": path.stat().st_size, **to_mapping(policy.metadata)}


def _show(title: str, policy: "OnnxPolicy", first: list[list[str]]) -> None:
    about = policy.metadata
    robot, control = about.robot, about.control
    period = "not known" if control.period is None else f"{control.period:g} s"
    rows = [
        *first,
        ["written by", f"kinfeas {about.version}"],
        ["robot", f"{robot.name}, {robot.drive}"],
        ["kinematics", f"{robot.kinematics[:23]}..."],
        ["EE frame", robot.ee_frame],
        ["base frame", robot.base_frame],
        ["control period in training", period],
        ["planned motion that it sees", f"{control.horizon:g} s"],
        *_training(about),
        ["golden pairs answered", str(len(about.golden.action))],
    ]
    print_table(title, ["", "value"], rows)
    print_table("observation", [" number", "field", "frame", "unit"], _observed(about))
    actions = [
        [str(i), f"{term.name} {name}", f"{scale:g}", term.unit]
        for term in about.action
        for i, (name, scale) in enumerate(zip(term.entries, term.scale, strict=True))
    ]
    print_table("action, in [-1, 1]", [" number", "term", "1 means", "unit"], actions)


def _observed(about: "PolicyMetadata") -> list[list[str]]:
    first, rows = 0, []
    for field in about.observation:
        last = first + field.size - 1
        numbers = str(first) if first == last else f"{first}-{last}"
        rows.append([numbers, field.name, field.frame, field.unit])
        first += field.size
    return rows


def _training(about: "PolicyMetadata") -> list[list[str]]:
    """Return rows on how a policy was trained and how well it does, as far as that is known."""
    config, steps = about.training.get("config"), about.training.get("steps")
    rows = []
    if isinstance(config, dict):
        rows.append(["trained for the task", str(config.get("task"))])
    if isinstance(steps, int):
        rows.append(["steps of training", f"{steps:,}"])
    figures = {"evaluation": about.success.get("evaluation")}
    benchmark = about.success.get("benchmark")
    figures |= benchmark if isinstance(benchmark, dict) else {}
    for name, found in figures.items():
        if isinstance(found, dict) and isinstance(found.get("success"), float):
            text = f"{share(found['success'])} of {found.get('episodes')} episodes"
            rows.append([f"success, {name}", text])
    return rows
