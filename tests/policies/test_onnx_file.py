import json
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from kinfeas.control.drive import action_size
from kinfeas.control.observation import HORIZON, size
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import PolicyInput
from kinfeas.policies import onnx_file as policy_file
from kinfeas.policies.onnx_file import TOLERANCE, read_policy_file
from kinfeas.robots.loading import load_robot
from tests.sim2real.policy_cases import change, get_entry, set_entry, write_policy_file


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


@pytest.fixture(scope="module")
def content(pr2, tmp_path_factory):
    """The bytes of a policy file of the PR2."""
    return write_policy_file(pr2, tmp_path_factory.mktemp("file"))[1].read_bytes()


@pytest.fixture
def path(content, tmp_path):
    """A policy file of the PR2 to spoil."""
    (tmp_path / "pr2.onnx").write_bytes(content)
    return tmp_path / "pr2.onnx"


def observations(network, n, seed=5):
    return np.random.default_rng(seed).normal(size=(n, len(network.scale))) / network.scale


def test_acts_as_the_training_policy(robot, tmp_path):
    network, path = write_policy_file(robot, tmp_path, net_arch=256)
    policy = read_policy_file(path, robot)
    seen = observations(network, 200) * 2.0
    np.testing.assert_allclose(policy(seen), network(seen), rtol=0.0, atol=TOLERANCE)
    nothing = np.full((200, 7), np.nan)
    policy_input = PolicyInput(seen, nothing, nothing, nothing, nothing, nothing)
    np.testing.assert_array_equal(policy.act(policy_input), policy(seen))


@pytest.mark.parametrize("n", [0, 1, 5])
def test_shape_and_bounds(path, pr2, n):
    action = read_policy_file(path, pr2)(np.full((n, 28), 1e6))
    assert action.shape == (n, 3)
    assert action.dtype == np.float64
    assert np.all(np.abs(action) <= 1.0)


def test_no_bit_depends_on_the_batch(pr2, tmp_path):
    network, path = write_policy_file(pr2, tmp_path, net_arch=256)
    policy, seen = read_policy_file(path, pr2), observations(network, 64)
    together = policy(seen)
    for count in (1, 3, 16):
        parts = [policy(seen[first : first + count]) for first in range(0, 64, count)]
        np.testing.assert_array_equal(np.concatenate(parts), together)
    np.testing.assert_array_equal(policy(np.asfortranarray(seen)[::-1]), together[::-1])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_finite_shows(path, pr2, bad):
    seen = np.zeros((3, 28))
    seen[1, 5] = bad
    with np.errstate(over="ignore"):
        finite = np.isfinite(read_policy_file(path, pr2)(seen))
    assert finite.tolist() == [[True] * 3, [False] * 3, [True] * 3]


def test_survives_the_way_to_a_worker_process(path, pr2):
    policy = read_policy_file(path, pr2)
    copy = pickle.loads(pickle.dumps(policy))
    seen = np.ones((2, 28))
    assert copy.about == policy.about
    np.testing.assert_array_equal(copy(seen), policy(seen))


def test_says_what_it_is(robot, tmp_path):
    about = read_policy_file(write_policy_file(robot, tmp_path)[1], robot).about
    assert about.robot.name == robot.name
    assert sum(field.size for field in about.observation) == size(len(robot.arm))
    joints = [field.name for field in about.observation if field.frame == "joint"]
    assert joints == [joint.name for joint in robot.arm]
    limits = [(one.unit, one.limit) for one in about.action]
    assert len(limits) == action_size(robot.base)
    assert limits[0] == ("m/s", robot.base.max_velocity)
    assert limits[-1] == ("rad/s", robot.base.max_rotation)
    assert (about.control.period, about.control.horizon) == (0.1, HORIZON)
    assert about.training["steps"] == 1000
    assert about.success["evaluation"] == {"episodes": 256, "success": 0.9}
    assert set(about.success) == {"evaluation", "benchmark"}


def test_needs_neither_torch_nor_onnx_and_says_nothing(path):
    code = f"""
import sys
from pathlib import Path
import numpy as np
from kinfeas.robots.loading import load_robot
from kinfeas.policies.onnx_file import read_policy_file

read_policy_file(Path({str(path)!r}), load_robot("pr2"))(np.zeros((1, 28)))
loaded = {{name.split(".")[0] for name in sys.modules}}
assert not loaded & {{"torch", "stable_baselines3", "gymnasium", "onnx", "sklearn"}}, loaded
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_look_at_the_file_needs_no_robot(path):
    assert read_policy_file(path, None).about.robot.name == "pr2"


def refused(path, robot, match):
    with pytest.raises(KinfeasError, match=match) as caught:
        read_policy_file(path, robot)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_another_robot(path):
    refused(path, load_robot("hsr"), "for robot 'pr2', not for 'hsr'")


def test_a_robot_of_the_same_name_with_other_kinematics(path, pr2):
    slower = replace(pr2, base=replace(pr2.base, max_velocity=0.1))
    refused(path, slower, "the kinematics of robot 'pr2' are not those")


def test_gentler_accelerations_are_no_other_kinematics(path, pr2):
    gentle = replace(pr2, base=replace(pr2.base, max_acceleration=0.1))
    assert read_policy_file(path, gentle).about.robot.name == "pr2"


def test_truncated_anywhere(path, content, pr2):
    for end in [*range(0, len(content), 97), len(content) - 1]:
        path.write_bytes(content[:end])
        refused(path, pr2, ".")


def test_changed_anywhere(path, content, pr2):
    rng = np.random.default_rng(0)
    for at in rng.integers(len(content), size=150):
        spoiled = bytearray(content)
        spoiled[at] ^= 1 << rng.integers(8)
        path.write_bytes(spoiled)
        refused(path, pr2, ".")


@pytest.mark.parametrize("more", [b"\0", b"\x08\x07", b"some words", b"\xa2\x06\x01x"])
def test_something_added(path, content, pr2, more):
    path.write_bytes(content + more)
    refused(path, pr2, ".")


@pytest.mark.parametrize(
    "other", [b"", b"{}", b"a text about something", b"PK\x03\x04" * 99, pickle.dumps([1.0])]
)
def test_other_files(path, pr2, other):
    path.write_bytes(other)
    refused(path, pr2, "not an ONNX file|its metadata lacks a schema")


def test_a_foreign_onnx_file(path, pr2):
    change(path, lambda model: model.ClearField("metadata_props"), sign=False)
    refused(path, pr2, "not a policy that `kinfeas export` wrote")


def test_no_file_and_a_folder(tmp_path, pr2):
    refused(tmp_path / "none.onnx", pr2, "No such file")
    refused(tmp_path, pr2, "Is a directory")


def test_a_huge_file(path, pr2, monkeypatch):
    monkeypatch.setattr(policy_file, "MAX_BYTES", 1000)
    refused(path, pr2, "too large, at most 1000 bytes")


def weaken(model):
    tensor = next(one for one in model.graph.initializer if one.name == "weight_0")
    values = numpy_helper.to_array(tensor) * np.float32(0.9)
    tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))


def test_other_weights(path, pr2):
    change(path, weaken, sign=False)
    refused(path, pr2, "changed after its export")


def test_other_weights_and_a_digest_that_fits(path, pr2):
    change(path, weaken)
    refused(path, pr2, "answers its golden pairs wrongly")


def test_other_words(path, pr2):
    change(path, lambda model: set_entry(model, "success", {}), sign=False)
    refused(path, pr2, "changed after its export")


def in_other_files(model):
    from onnx.external_data_helper import convert_model_to_external_data

    convert_model_to_external_data(model, location="weights.bin", size_threshold=0)


def set_tensor(name, values):
    def edit(model):
        tensor = next(one for one in model.graph.initializer if one.name == name)
        tensor.CopyFrom(numpy_helper.from_array(values(numpy_helper.to_array(tensor)), name))

    return edit


def set_node(at, **fields):
    def edit(model):
        for key, value in fields.items():
            setattr(model.graph.node[at], key, value)

    return edit


def rewire(model):
    model.graph.node[3].input[0] = model.graph.node[1].output[0]


GRAPHS = {
    "external data": (in_other_files, "weights in another file"),
    "NaN": (set_tensor("weight_1", lambda w: w * np.float32(np.nan)), "not finite"),
    "infinite": (set_tensor("bias_0", lambda b: b + np.float32(np.inf)), "not finite"),
    "doubles": (set_tensor("bias_0", lambda b: b.astype(float)), "float32"),
    "other shape": (set_tensor("weight_0", lambda w: w.T), "shapes of its weights"),
    "no numbers": (set_tensor("weight_0", lambda w: w[:0]), "float32"),
    "other inputs": (set_tensor("scale", lambda s: s[:5]), "shapes of its weights"),
    "custom operator": (set_node(1, domain="evil", op_type="Run"), "operator 'evil.Run'"),
    "custom domain": (set_node(0, domain="evil"), "operator 'evil.Mul'"),
    "other operator": (set_node(-1, op_type="Sigmoid"), "'Sigmoid'; allowed are Mul"),
    "other order": (set_node(0, op_type="Relu"), "not those of a perceptron"),
    "subgraph": (
        lambda m: m.graph.node[0].CopyFrom(
            helper.make_node("If", ["x"], ["y"], then_branch=m.graph, else_branch=m.graph)
        ),
        "operator 'If'",
    ),
    "attribute": (
        lambda m: m.graph.node[2].attribute.append(helper.make_attribute("alpha", 0.5)),
        "attributes",
    ),
    "function": (
        lambda m: m.functions.append(helper.make_function("evil", "Mul", [], [], [], [])),
        "functions of its own",
    ),
    "training": (lambda m: m.training_info.add(), "training information"),
    "sparse": (lambda m: m.graph.sparse_initializer.add(), "sparse weights"),
    "detour": (rewire, "one line from"),
    "no clipping": (lambda m: m.graph.node.pop(1), "not those of a perceptron"),
    "left over": (
        lambda m: m.graph.initializer.append(numpy_helper.from_array(np.float32(1), "x")),
        "one line from",
    ),
    "twice": (
        lambda m: m.graph.initializer.append(m.graph.initializer[0]),
        "two of its tensors have one name",
    ),
    "other operators": (lambda m: m.opset_import.append(helper.make_opsetid("x", 1)), "only ai"),
    "other version": (lambda m: setattr(m.opset_import[0], "version", 99), "only ai.onnx 14"),
    "other format": (lambda m: setattr(m, "ir_version", 99), "only ai.onnx 14, format 7"),
    "one row only": (
        lambda m: setattr(m.graph.input[0].type.tensor_type.shape.dim[0], "dim_value", 1),
        r"'observation' must be float32 of shape \(batch, 28\)",
    ),
    "whole numbers": (
        lambda m: setattr(m.graph.output[0].type.tensor_type, "elem_type", TensorProto.INT64),
        r"'action' must be float32 of shape \(batch, 3\)",
    ),
    "two outputs": (lambda m: m.graph.output.append(m.graph.output[0]), "2 times"),
}


@pytest.mark.parametrize("case", GRAPHS)
def test_other_graphs(path, pr2, case):
    edit, match = GRAPHS[case]
    change(path, edit)
    refused(path, pr2, match)


def edit_entry(key, edit):
    return lambda model: set_entry(model, key, edit(get_entry(model, key)))


METADATA = {
    "schema": (edit_entry("schema", lambda s: 2), "its schema is '2', .*reads schema 1"),
    "robot": (edit_entry("robot", lambda r: "pr2"), "'robot' must be a mapping"),
    "unknown": (lambda m: m.metadata_props.add(key="kinfeas.more", value="1"), "unknown key"),
    "foreign": (lambda m: m.metadata_props.add(key="more", value="1"), "unknown key 'more'"),
    "twice": (lambda m: m.metadata_props.append(m.metadata_props[0]), "two entries"),
    "missing": (lambda m: m.metadata_props.pop(3), "'observation' is missing"),
    "no JSON": (lambda m: setattr(m.metadata_props[3], "value", "{"), "is not JSON"),
    "not finite": (
        lambda m: setattr(m.metadata_props[7], "value", '{"a": 1e999}'),
        "'kinfeas.success' is not JSON: 1e999 is not finite",
    ),
    "fewer actions": (edit_entry("action", lambda a: a[:2]), "3 outputs.* describes 28 and 2"),
    "no golden pairs": (
        edit_entry("golden", lambda g: {"observation": [], "action": []}),
        "golden pairs are missing",
    ),
    "short golden pairs": (
        edit_entry("golden", lambda g: {"observation": [[0.0]], "action": [[0.0] * 3]}),
        "golden pairs are missing or of the wrong size",
    ),
    "uneven golden pairs": (
        edit_entry("golden", lambda g: {**g, "action": g["action"][:3]}),
        "golden pairs are missing or of the wrong size",
    ),
    "other order": (edit_entry("observation", lambda o: o[::-1]), "other things than this version"),
    "other scale": (
        edit_entry("action", lambda a: [{**one, "limit": 9.0} for one in a]),
        "other things than this version",
    ),
    "other horizon": (
        edit_entry("control", lambda c: {**c, "horizon": 0.2}),
        "other things than this version",
    ),
}


@pytest.mark.parametrize("case", METADATA)
def test_other_metadata(path, pr2, case):
    edit, match = METADATA[case]
    change(path, edit)
    refused(path, pr2, match)


def test_onnxruntime_gets_no_file_but_this_one(path, pr2, monkeypatch):
    """Weights beside the file are not looked for, whatever lies there."""
    change(path, in_other_files)
    (path.parent / "weights.bin").write_bytes(b"\0" * 100_000)
    monkeypatch.chdir(path.parent)
    refused(path, pr2, "weights in another file")


def test_the_entries_are_json(path):
    entries = {one.key: one.value for one in onnx.load(path).metadata_props}
    assert len(entries) == 10
    for key, value in entries.items():
        assert key.startswith("kinfeas.")
        json.loads(value)
