import json
import re
import runpy
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
import pytest

from kinfeas.control.observation import (
    OBSERVATION,
    ObservedState,
    describe_observation,
    observe,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import export as export_module
from kinfeas.policies.export import GOLDEN_PAIRS, export
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import TOLERANCE, read_policy_file
from tests.policy_cases import write_run

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "onnx_inference.py"


def test_the_shipped_policies(robot, tmp_path):
    folder = robot.folder / "policies" / "pretrained"
    policy, off = export(folder, robot, tmp_path / "policy.onnx")
    assert off <= TOLERANCE / 2.0
    assert policy.metadata.success["evaluation"]["success"] > 0.7
    network, golden = read_network(folder, robot), policy.metadata.golden
    assert len(golden.action) == GOLDEN_PAIRS
    np.testing.assert_allclose(network(np.array(golden.observation)), golden.action, atol=1e-7)
    assert np.abs(np.array(golden.observation) * network.scale).max() > 2.0
    model = onnx.load(tmp_path / "policy.onnx", load_external_data=False)
    assert {node.op_type for node in model.graph.node} == {"Mul", "Clip", "Gemm", "Relu", "Tanh"}
    assert [one.type.tensor_type.shape.dim[0].dim_param for one in model.graph.input] == ["batch"]


def test_takes_the_best_checkpoint_and_its_run_s_figures(pr2, tmp_path):
    run = tmp_path / "runs" / "mine"
    best = write_run(pr2, run / "checkpoints" / "best")
    write_run(pr2, run / "checkpoints" / "last", net_arch=4)
    figures = {"policy": "/home/me/runs/mine", "task": "door", "episodes": 500, "success": 0.5}
    (run / "evaluation.json").write_text(json.dumps(figures))
    policy, _ = export(run, pr2, tmp_path / "policy.onnx")
    np.testing.assert_allclose(policy(np.ones((1, 28))), best(np.ones((1, 28))), atol=TOLERANCE)
    metadata = policy.metadata
    assert metadata.success["evaluation"] == {"task": "door", "episodes": 500, "success": 0.5}
    assert b"/home/me" not in (tmp_path / "policy.onnx").read_bytes()
    assert metadata.training == {"config": metadata.training["config"], "steps": 1000}


def test_a_policy_that_deviates_is_not_written(pr2, tmp_path, monkeypatch):
    write_run(pr2, tmp_path)
    monkeypatch.setattr(export_module, "_run", lambda _, rows: np.zeros((len(rows), 3)))
    with pytest.raises(KinfeasError, match="deviates"):
        export(tmp_path, pr2, tmp_path / "policy.onnx")
    assert not (tmp_path / "policy.onnx").exists()


def test_inference_with_onnxruntime_alone(pr2, tmp_path, monkeypatch):
    write_run(pr2, tmp_path)
    export(tmp_path, pr2, tmp_path / "pr2.onnx")
    assert "kinfeas" not in re.findall(r"^(?:import|from) (\w+)", EXAMPLE.read_text(), re.M)
    monkeypatch.chdir(tmp_path)
    observation, twist = runpy.run_path(str(EXAMPLE))["main"]()
    action = read_policy_file(tmp_path / "pr2.onnx", pr2)(observation)[0]
    speed = np.hypot(*action[:2]) * 0.2
    expected = action * [0.2, 0.2, 1.0] * [*[0.2 / max(speed, 0.2)] * 2, 1.0]
    np.testing.assert_allclose(twist, expected, atol=1e-5)


def test_the_example_observes_as_the_loop_does(pr2):
    terms = [asdict(term) for term in describe_observation(pr2, OBSERVATION)]
    example = runpy.run_path(str(EXAMPLE))
    rng = np.random.default_rng(0)
    poses = rng.normal(size=(4, 50, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    poses[1, :, 3:] *= np.sign(poses[1, :, 6:])  # where the EE is, w >= 0 as forward kinematics say
    joints = rng.normal(size=(50, 7))
    shown = [
        example["observe"](terms, *row, angles) for *row, angles in zip(*poses, joints, strict=True)
    ]
    np.testing.assert_allclose(shown, observe(ObservedState(*poses, joints)), atol=1e-12)
