import json
import re
import runpy
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from kinfeas.api.load import check_export
from kinfeas.control.observation import (
    HORIZON,
    OBSERVATION,
    ObservedState,
    describe_observation,
    observe,
    size,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Observation
from kinfeas.kinematics.drive import command_size
from kinfeas.policies import export as export_module
from kinfeas.policies import onnx_policy
from kinfeas.policies.export import GOLDEN_PAIRS, export
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import TOLERANCE, digest_entry, read_policy_file
from kinfeas.robots.loading import load_robot
from tests.policy_cases import change, get_entry, set_entry, write_policy_file, write_run


@pytest.fixture(scope="module")
def exported(hsr, tmp_path_factory):
    network, path = write_policy_file(hsr, tmp_path_factory.mktemp("file"), net_arch=64)
    return network, path.read_bytes()


@pytest.fixture
def path(exported, tmp_path):
    (tmp_path / "hsr.onnx").write_bytes(exported[1])
    return tmp_path / "hsr.onnx"


def observations(network, n):
    rng = np.random.default_rng(5)
    return 2.0 * rng.normal(size=(n, len(network.scale))) / network.scale


def test_acts_as_the_training_policy_whatever_the_batch(path, exported, hsr):
    network, policy = exported[0], read_policy_file(str(path), hsr)
    seen = observations(network, 64)
    together = policy(seen)
    np.testing.assert_array_equal(together, network(seen))
    for count in (1, 3, 16):
        parts = [policy(seen[first : first + count]) for first in range(0, 64, count)]
        np.testing.assert_array_equal(np.concatenate(parts), together)
    np.testing.assert_array_equal(policy(np.asfortranarray(seen)[::-1]), together[::-1])
    unused = np.full((64, 7), np.nan)
    np.testing.assert_array_equal(policy.act(Observation(seen, *[unused] * 7, 0.1)), together)


def test_metadata_describe_the_robot(robot, tmp_path):
    found = read_policy_file(write_policy_file(robot, tmp_path)[1], None).metadata
    assert found.robot.name == robot.name
    assert sum(term.size for term in found.observation) == size(robot)
    assert found.observation[-1].entries == tuple(joint.name for joint in robot.arm)
    (action,) = found.action
    limits = [robot.base.max_velocity] * (command_size(robot.base) - 1) + [robot.base.max_rotation]
    assert list(action.scale) == limits
    assert (found.control.period, found.control.horizon) == (0.1, HORIZON)
    assert found.training["steps"] == 1000
    evaluation = found.success["evaluation"]
    assert evaluation.items() >= {"episodes": 256, "success": 0.9}.items()


def rejected(path, robot, word):
    with pytest.raises(KinfeasError, match=word) as caught:
        read_policy_file(path, robot)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_another_robot_or_other_kinematics(path, hsr):
    rejected(path, load_robot("pr2"), "'hsr'.*'pr2'")
    rejected(path, replace(hsr, base=replace(hsr.base, max_velocity=0.1)), "kinematics")
    gentle = replace(hsr, base=replace(hsr.base, max_acceleration=0.1))
    assert read_policy_file(path, gentle).metadata.robot.name == "hsr"


def test_truncated_or_changed_anywhere(path, exported, hsr):
    content = exported[1]
    rng = np.random.default_rng(0)
    for end in [*range(0, len(content), 997), len(content) - 1]:
        path.write_bytes(content[:end])
        rejected(path, hsr, ".")
    for at in [*rng.integers(len(content), size=50), *range(len(content) - 90, len(content), 7)]:
        changed = bytearray(content)
        changed[at] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        rejected(path, hsr, ".")


def test_other_files(path, hsr, monkeypatch):
    change(path, lambda model: model.ClearField("metadata_props"), sign=False)
    for other in (path.read_bytes(), b"", b"PK\x03\x04" * 99):
        path.write_bytes(other)
        rejected(path, hsr, "not written by `kinfeas export`")
    rejected(path.parent / "none.onnx", hsr, "No such file")
    monkeypatch.setattr(onnx_policy, "MAX_BYTES", 100)
    rejected(path, hsr, "100 bytes")


def set_tensor(name, values):
    def edit(model):
        tensor = next(one for one in model.graph.initializer if one.name == name)
        tensor.CopyFrom(numpy_helper.from_array(values(numpy_helper.to_array(tensor)), name))

    return edit


def edit_entry(key, edit):
    return lambda model: set_entry(model, key, edit(get_entry(model, key)))


def without_layers(model):
    first, last = model.graph.node[0], model.graph.node[-1]
    last.input[0] = first.output[0]
    del model.graph.node[1:-1]
    names = {"scale", "low", "high"}
    kept = [one for one in model.graph.initializer if one.name in names]
    del model.graph.initializer[:]
    model.graph.initializer.extend(kept)


SIGNED = {
    "other weights": (set_tensor("weight_0", lambda w: w * np.float32(0.9)), "golden"),
    "other clip": (set_tensor("low", lambda c: c - np.float32(1.0)), "clips"),
    "missing tensor": (lambda m: m.graph.initializer.pop(3), "graph"),
    "custom operator": (lambda m: setattr(m.graph.node[1], "domain", "evil"), "graph"),
    "schema": (edit_entry("schema", lambda s: 2), "schema"),
    "robot": (edit_entry("robot", lambda r: "pr2"), "'robot'"),
    "missing": (lambda m: m.metadata_props.pop(3), "'observation'"),
    "no JSON": (lambda m: setattr(m.metadata_props[3], "value", "{"), "JSON"),
    "fewer actions": (edit_entry("action", lambda a: [{**a[0], "size": 2}]), "graph"),
    "other term": (edit_entry("observation", lambda o: [{**o[0], "name": "x"}, *o[1:]]), "'x'"),
    "other scale": (edit_entry("action", lambda a: [{**a[0], "scale": [9.0] * 3}]), "action"),
    "deep metadata": (lambda m: setattr(m.metadata_props[3], "value", "[" * 100_000), "JSON"),
    "no golden pairs": (edit_entry("golden", lambda g: {key: [] for key in g}), "golden"),
    "no layers": (without_layers, "graph"),
    "other period": (edit_entry("control", lambda c: {**c, "period": 1e-9}), "period"),
    "other horizon": (edit_entry("control", lambda c: {**c, "horizon": 0.2}), "observation or"),
}


@pytest.mark.parametrize("tail", [b"\x08" + b"\xff" * 2_000_000, b"\x3a" + b"\xff" * 9 + b"\x01"])
def test_integers_without_end(path, hsr, tail):
    change(path, lambda model: None, sign=False)
    body = path.read_bytes() + tail
    path.write_bytes(body + digest_entry(body))
    rejected(path, hsr, "graph")


@pytest.mark.parametrize("case", SIGNED)
def test_changes_with_a_matching_digest(path, hsr, case):
    edit, word = SIGNED[case]
    change(path, edit)
    rejected(path, hsr, word)
    with pytest.raises(KinfeasError, match=word):
        check_export(path)


ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "onnx_inference.py"


def test_the_shipped_policies(robot, tmp_path):
    folder = robot.folder / "policies" / "pretrained"
    policy, off = export(folder, robot, tmp_path / "policy.onnx")
    assert off <= TOLERANCE / 2.0
    evaluation = policy.metadata.success["evaluation"]
    assert (evaluation["world"], evaluation["task"][:3]) == ("analytic", "ggr")
    assert evaluation["success"] > 0.7
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
    (unknown,) = (asdict(term) for term in describe_observation(pr2, ["previous_command"]))
    with pytest.raises(SystemExit, match="previous_command"):
        example["observe"]([*terms, unknown], *poses[:, 0], joints[0])
