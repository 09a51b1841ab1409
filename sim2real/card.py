"""The model card of a policy: Markdown with the metadata that the Hugging Face Hub reads."""

import json
from collections.abc import Mapping
from typing import Any

from kinfeas.config import strict_yaml
from kinfeas.control.observation import SCAN_TERMS
from kinfeas.core.policy import TermInfo
from kinfeas.policies.onnx_policy import PolicyMetadata

_TEXT = """\
# Base policy for {robot}

A policy of kinfeas that moves the base of `{robot}` so that
its arm can follow any end-effector (EE) motion. Drive: {drive}; EE frame: `{ee_frame}`; control
period while training: {period}.

```sh
kinfeas pull USER/NAME --out policy
kinfeas evaluate --policy policy --robot {robot}
```

`policy.onnx` runs with onnxruntime alone; it holds this description and pairs of inputs and outputs
to check a runtime with. Nothing in the files is unpickled.

## Results

{results}

Success: share of episodes that reach the goal without an IK failure, with the 95 % interval, in the
world that the policy was trained for.

## Observation

{observation}

## Action

{action}

## Training

{training}

## Limits

- Valid for the kinematics with the hash `{kinematics}` only; kinfeas raises an error on others.
{limits}- The metrics come from simulation.
"""


def model_card(metadata: PolicyMetadata) -> str:
    """Return the model card of an exported policy."""
    robot, period = metadata.robot, metadata.control.period
    head = {
        "library_name": "kinfeas",
        "pipeline_tag": "robotics",
        "tags": ["kinfeas", "mobile-manipulation", "reinforcement-learning", robot.name],
    }
    known = {key: value for key, value in metadata.training.items() if key != "config"}
    recipe = strict_yaml.to_text(metadata.training.get("config", {}))
    training = [
        f"- {key}: {_text(value)}" for key, value in {**known, **_version(metadata)}.items()
    ]
    text = _TEXT.format(
        robot=robot.name,
        drive=robot.drive,
        ee_frame=robot.ee_frame,
        kinematics=robot.kinematics,
        period=f"{period:g} s" if period else "unknown",
        results=_results(metadata),
        observation=_terms(metadata.observation),
        action=_terms(metadata.action),
        limits=_limits(metadata),
        training="\n".join([*training, "", "```yaml", recipe.rstrip(), "```"]),
    )
    return f"---\n{strict_yaml.to_text(head)}---\n\n{text}"


def _limits(metadata: PolicyMetadata) -> str:
    config: Any = metadata.training.get("config", {})
    backend = config.get("world", {}).get("backend", "analytic")
    blind = not SCAN_TERMS & {term.name for term in metadata.observation}
    limits = {
        "- The training world has no forces and no slip.\n": backend == "analytic",
        "- The policy does not observe obstacles.\n": blind,
    }
    return "".join(text for text, applies in limits.items() if applies)


def _version(metadata: PolicyMetadata) -> dict[str, object]:
    return {"exported with": f"kinfeas {metadata.version}"}


def _results(metadata: PolicyMetadata) -> str:
    lines = ["| task | episodes | success, % |", "|---|---|---|"]
    evaluation, tasks = (metadata.success.get(key, {}) for key in ("evaluation", "benchmark"))
    found = dict(tasks) if isinstance(tasks, Mapping) else {}
    if not found and isinstance(evaluation, Mapping):
        found = {evaluation.get("task", "of the training"): evaluation}
    for task, metrics in found.items():
        share, low, high = (metrics.get(key) for key in ("success", "success_low", "success_high"))
        if share is not None:
            ends = "" if low is None or high is None else f" ({100 * low:.1f} - {100 * high:.1f})"
            lines.append(f"| `{task}` | {metrics.get('episodes')} | {100 * share:.1f}{ends} |")
    return "\n".join(lines) if len(lines) > 2 else "Not evaluated."


def _terms(terms: tuple[TermInfo, ...]) -> str:
    rows = [f"| `{one.name}` | {one.size} | {one.unit} | {one.frame} |" for one in terms]
    return "\n".join(["| term | size | unit | frame |", "|---|---|---|---|", *rows])


def _text(value: object) -> str:
    return f"`{value}`" if isinstance(value, str) else json.dumps(value)
