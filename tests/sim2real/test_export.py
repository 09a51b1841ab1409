import hashlib
import json
import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from kinfeas.control.observation import observe, scaled
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.policies.network import Network, read_network, write_network
from kinfeas.policies.onnx_file import TOLERANCE, read_policy_file
from kinfeas.policies.onnx_graph import OPERATORS
from kinfeas.policies.onnx_metadata import About
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.export import GOLDEN_PAIRS, export
from tests.sim2real.policy_cases import write_run

PAGE = (Path(__file__).parents[2] / "docs" / "export.md").read_text()


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


@pytest.mark.parametrize("hidden", [1, 8, 256])
def test_is_a_whole_and_plain_onnx_model(robot, tmp_path, hidden):
    write_run(robot, tmp_path, hidden)
    export(tmp_path, robot, tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx", load_external_data=False)
    onnx.checker.check_model(model, full_check=True)
    assert {node.op_type for node in model.graph.node} == set(OPERATORS)
    assert all(tensor.data_location == 0 for tensor in model.graph.initializer)
    assert [one.type.tensor_type.shape.dim[0].dim_param for one in model.graph.input] == ["batch"]


def test_the_shipped_policies(robot, tmp_path):
    folder = pretrained.find(robot.name)
    policy, off = export(folder, robot, tmp_path / "policy.onnx")
    assert off <= TOLERANCE / 5.0
    assert policy.about.success["benchmark"]["ggr"]["success"] > 0.7
    network = read_network(folder, robot)
    weights = sum(one.nbytes for one in (*network.weights, *network.biases))
    assert (tmp_path / "policy.onnx").stat().st_size < weights + 20_000
    golden = policy.about.golden
    assert len(golden.action) == GOLDEN_PAIRS
    np.testing.assert_allclose(network(np.array(golden.observation)), golden.action, atol=1e-7)
    assert np.abs(np.array(golden.observation) * network.scale).max() > 2.0


@pytest.mark.parametrize("sizes", [(28, 3), (28, 7, 3), (28, 40, 30, 20, 3)])
def test_any_number_of_layers(pr2, tmp_path, sizes):
    rng = np.random.default_rng(0)
    pairs = [(sizes[i], sizes[i + 1]) for i in range(len(sizes) - 1)]
    network = Network(
        np.ones(28, dtype=np.float32),
        tuple((rng.normal(size=pair) / pair[0] ** 0.5).astype(np.float32) for pair in pairs),
        tuple(rng.normal(size=pair[1]).astype(np.float32) for pair in pairs),
    )
    write_network(network, tmp_path, pr2, {})
    policy, off = export(tmp_path, pr2, tmp_path / "policy.onnx")
    assert off <= TOLERANCE
    assert policy.about.control.period is None
    assert policy.about.training == policy.about.success == {}


@pytest.mark.parametrize("algorithm", ["sac", "td3"])
def test_acts_as_the_actor_that_was_trained(pr2, tmp_path, algorithm):
    torch = pytest.importorskip("torch")
    from kinfeas.envs.world import World, WorldConfig
    from kinfeas.training.config import LearnerConfig
    from kinfeas.training.learner import make_learner, network_of
    from kinfeas.training.vec_env import WorldVecEnv

    task = registry.build("kinfeas.tasks", "ggr", {})
    env = WorldVecEnv(World(pr2, task, WorldConfig(), 0), 2)
    config = LearnerConfig(algorithm=algorithm, net_arch=(64, 64), buffer_size=100)
    learner = make_learner(config, env, 0)
    with torch.no_grad():
        for parameter in learner.actor.parameters():
            parameter.mul_(3.0)  # so that no action is near 0
    write_network(network_of(learner, env.scale), tmp_path, pr2, {})
    policy, _ = export(tmp_path, pr2, tmp_path / "policy.onnx")
    seen = env.world.start(range(64))
    expected, _ = learner.predict(scaled(seen, env.scale), deterministic=True)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(policy(seen), expected, rtol=0.0, atol=TOLERANCE)


def test_takes_the_best_checkpoint_and_its_run_s_figures(pr2, tmp_path):
    run = tmp_path / "runs" / "mine"
    best = write_run(pr2, run / "checkpoints" / "best")
    write_run(pr2, run / "checkpoints" / "last", net_arch=4)
    figures = {"policy": "/home/me/runs/mine", "task": "door", "episodes": 500, "success": 0.5}
    (run / "evaluation.json").write_text(json.dumps(figures))
    policy, _ = export(run, pr2, tmp_path / "policy.onnx")
    np.testing.assert_allclose(policy(np.ones((1, 28))), best(np.ones((1, 28))), atol=TOLERANCE)
    assert policy.about.success["evaluation"] == {"task": "door", "episodes": 500, "success": 0.5}
    assert b"/home/me" not in (tmp_path / "policy.onnx").read_bytes()
    assert policy.about.training == {"config": policy.about.training["config"], "steps": 1000}


def test_the_same_policy_gives_the_same_file(pr2, tmp_path):
    write_run(pr2, tmp_path)
    for name in ("a.onnx", "b.onnx"):
        export(tmp_path, pr2, tmp_path / name)
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()


def test_writes_all_of_it_or_nothing(pr2, tmp_path, monkeypatch):
    write_run(pr2, tmp_path / "run")
    (tmp_path / "folder").mkdir()
    for out in (tmp_path / "folder", tmp_path / "none" / "policy.onnx"):
        with pytest.raises(KinfeasError, match=re.escape(f"{out}: cannot be written: ")):
            export(tmp_path / "run", pr2, out)
    (tmp_path / "policy.onnx").write_bytes(b"the one before")
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(KinfeasError, match="No space left"):
        export(tmp_path / "run", pr2, tmp_path / "policy.onnx")
    assert (tmp_path / "policy.onnx").read_bytes() == b"the one before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "policy.onnx", "run"]


def full_disk(path, content):
    with path.open("wb") as file:
        file.write(content[:100])
    raise OSError(28, "No space left on device")


def test_a_file_that_acts_otherwise_is_not_written(pr2, tmp_path, monkeypatch):
    write_run(pr2, tmp_path)

    def wrong(seen):
        return np.zeros((len(seen), 3))

    monkeypatch.setattr("kinfeas.sim2real.export.parse_policy_file", lambda *_: wrong)
    with pytest.raises(KinfeasError, match=r"acts otherwise than the training policy: .* off"):
        export(tmp_path, pr2, tmp_path / "policy.onnx")
    assert not (tmp_path / "policy.onnx").exists()


def test_settings_and_figures_that_are_no_numbers_become_words(pr2, tmp_path):
    endless = {"task_parameters": {"speeds": [math.inf, -math.inf, math.nan]}, "world": {"dt": 0.1}}
    write_run(pr2, tmp_path, extra={"config": endless})
    (tmp_path / "evaluation.json").write_text('{"success": NaN, "episodes": 9}')
    policy, _ = export(tmp_path, pr2, tmp_path / "policy.onnx")
    words = ["inf", "-inf", "nan"]
    assert policy.about.training["config"]["task_parameters"] == {"speeds": words}
    assert policy.about.success["evaluation"] == {"success": "nan", "episodes": 9}
    assert policy.about.control.period == 0.1


def test_a_robot_of_other_kinematics_is_refused(pr2, tmp_path):
    write_run(pr2, tmp_path)
    faster = replace(pr2, base=replace(pr2.base, max_velocity=1.0))
    with pytest.raises(KinfeasError, match="the kinematics of robot 'pr2' are not those"):
        export(tmp_path, faster, tmp_path / "policy.onnx")
    assert not (tmp_path / "policy.onnx").exists()


@pytest.mark.parametrize("text", ["{", "[]", "{}x", "[" * 200_000])
def test_broken_figures(pr2, tmp_path, text):
    write_run(pr2, tmp_path)
    (tmp_path / "evaluation.json").write_text(text)
    with pytest.raises(KinfeasError, match=r"evaluation.json: (broken JSON|must hold)"):
        export(tmp_path, pr2, tmp_path / "policy.onnx")


def test_the_example_of_the_page(pr2, tmp_path, monkeypatch, capsys):
    write_run(pr2, tmp_path)
    export(tmp_path, pr2, tmp_path / "pr2.onnx")
    (example,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S)
    assert "kinfeas import" not in example
    assert "import kinfeas" not in example
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(example, "docs/export.md", "exec"), names)
    action = read_policy_file(tmp_path / "pr2.onnx", pr2)(names["observation"])[0]
    speed = np.hypot(*action[:2]) * 0.2
    expected = action * [0.2, 0.2, 1.0] * [*[0.2 / max(speed, 0.2)] * 2, 1.0]
    np.testing.assert_allclose(names["twist"], expected, atol=1e-5)


def test_the_page_observes_as_the_loop_does():
    names: dict[str, Any] = {}
    start, end = PAGE.index("def times("), PAGE.index("# Put your robot's numbers here")
    exec(compile(PAGE[start:end], "docs/export.md", "exec"), {"np": np}, names)
    names["observe"].__globals__.update(names)
    rng = np.random.default_rng(0)
    poses = rng.normal(size=(4, 50, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    poses[1, :, 3:] *= np.sign(poses[1, :, 6:])  # where the EE is, w >= 0 as forward kinematics say
    joints = rng.normal(size=(50, 7))
    shown = [names["observe"](*row, angles) for *row, angles in zip(*poses, joints, strict=True)]
    np.testing.assert_allclose(shown, observe(*poses, joints), atol=1e-12)


def test_the_page_names_every_entry():
    for field in fields(About):
        assert f"| `kinfeas.{field.name}` |" in PAGE
    assert "| `kinfeas.schema` |" in PAGE
    assert "| `kinfeas.digest` |" in PAGE


def test_the_digest_can_be_computed_with_onnx_alone(pr2, tmp_path):
    write_run(pr2, tmp_path)
    export(tmp_path, pr2, tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx")
    (entry,) = (one for one in model.metadata_props if one.key == "kinfeas.digest")
    model.metadata_props.remove(entry)
    found = hashlib.sha256(model.SerializeToString()).hexdigest()
    assert json.loads(entry.value) == f"sha256:{found}"
