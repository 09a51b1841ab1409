"""`kinfeas export`: a trained policy as one ONNX file, and checks of such files."""

from pathlib import Path
from typing import Any

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_facts, status, write_json
from kinfeas.core.errors import KinfeasError


def export(
    policy: str | None = argument(None, "Folder of a run or checkpoint, or pretrained."),
    out: Path | None = options.file_option(None, "File to write.", ".onnx"),
    check: Path | None = option(None, "Verify this file, write nothing.", metavar="FILE.onnx"),
    robot: options.PolicyRobotName = None,
    json: options.JsonPath = None,
) -> None:
    """Write or verify a policy as ONNX file. The file describes itself.

    The file answers as the training policy does, to 1e-5. It runs with onnxruntime alone, and
    --policy of other commands takes it.

    Example: kinfeas export runs/pr2 --out pr2.onnx

    Example: kinfeas export --check pr2.onnx --robot pr2
    """
    from kinfeas.api import load as api

    if check is not None and policy is None and out is None:
        file = api.check_export(check, robot=robot)
        compared = f"fits {file.robot}" if file.robot else "not compared with a robot: no --robot"
        title = f"valid policy file: {check}, {compared}"
    elif policy is not None and out is not None and check is None:
        with status("exporting"):
            file = api.export(policy, out, robot=robot)
        title = f"exported: {out}"
    else:
        raise KinfeasError("give POLICY and --out FILE to export, or --check FILE to verify")
    facts: dict[str, Any] = file.facts()
    write_json(facts, json)
    for terms in ("observation", "action"):
        facts[terms] = [{k: v for k, v in term.items() if v != []} for term in facts[terms]]
    print_facts(title, {k: v for k, v in facts.items() if k not in ("training", "golden")})
