import json
import os
import pickle
import shutil
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kinfeas.config import registry
from kinfeas.control.observation import CLIP, OBSERVATION
from kinfeas.core.errors import KinfeasError
from kinfeas.io.policy_metadata import read_trained, write_trained
from kinfeas.policies.loading import load_policy, trained_folder, trained_policies
from kinfeas.policies.network import Network, read_network, write_network
from kinfeas.robots.robot import fingerprint
from kinfeas.testing import ConformanceError, check_policy
from tests.builders import random_network


@pytest.fixture
def trained(hsr, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    write_network(random_network(hsr, width=8), folder, hsr, {})
    return folder


LONG = {"geometric_modulation", "planner"}  # baselines that take long


@pytest.mark.parametrize("name", sorted({*registry.names("kinfeas.policies")} - LONG))
def test_baselines_keep_the_contract_of_policies(hsr, name):
    check_policy(load_policy(name, hsr), hsr)


def test_a_class_of_a_module_in_the_working_folder(hsr, tmp_path, monkeypatch):
    (tmp_path / "my_policy.py").write_text(
        "import numpy as np\n"
        "class Still:\n"
        "    def __init__(self, robot): self.size = 3\n"
        "    def act(self, given): return np.zeros((len(given.base_pose), self.size))\n"
        "class Ends(Still):\n"
        "    def __init__(self, robot): raise SystemExit(0)\n"
        "class Loud(Still):\n"
        "    def act(self, given): return 2.0 + super().act(given)\n"
        "class Sums(Still):\n"
        "    def reset(self, rows, n):\n"
        "        self.sum = np.zeros((n, 1)) if len(rows) == n else self.sum\n"
        "    def act(self, given):\n"
        "        self.sum = self.sum + 0.01\n"
        "        return super().act(given) + self.sum\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    check_policy(load_policy("my_policy:Still", hsr), hsr)
    with pytest.raises(ConformanceError, match=r"Loud.*\[-1, 1\]"):
        check_policy(load_policy("my_policy:Loud", hsr), hsr)
    with pytest.raises(ConformanceError, match=r"Sums.*reset"):
        check_policy(load_policy("my_policy:Sums", hsr), hsr)
    for wrong in ("my_policy:Nothing", "no_policy:Still", "my_policy:Ends"):
        with pytest.raises(KinfeasError, match=wrong.partition(":")[2]):
            load_policy(wrong, hsr)


def test_wrong_folders_and_files_raise_errors_that_name_them(hsr, trained, tmp_path):
    (tmp_path / "empty.onnx").write_bytes(b"")
    (tmp_path / "none").mkdir()
    for name in ("empty.onnx", "none"):
        with pytest.raises(KinfeasError, match=name):
            load_policy(str(tmp_path / name), hsr)
    os.mkfifo(tmp_path / "pipe.onnx")  # a reader of a pipe waits for its writer
    for name, why in {"pipe": "regular file", "missing": "No such file"}.items():
        with pytest.raises(KinfeasError, match=rf"{name}\.onnx: .*{why}"):
            load_policy(str(tmp_path / f"{name}.onnx"), hsr)
    path = trained / "policy.json"
    path.write_text(path.read_text().replace('"hsr"', '"other"'))
    with pytest.raises(KinfeasError, match="'other'"):
        load_policy(str(trained), hsr)


def test_policies_in_the_folder_of_a_robot_have_names(hsr, trained, tmp_path):
    assert trained_policies(hsr) == ["pretrained"]
    own = replace(hsr, folder=tmp_path)  # the name of the robot gives it nothing
    assert trained_policies(own) == []
    with pytest.raises(KinfeasError, match=f"{tmp_path}.*kinfeas train"):
        load_policy("pretrained", own)
    shutil.copytree(trained, tmp_path / "policies" / "mine")
    shutil.copytree(trained, tmp_path / "policies" / "run" / "checkpoints" / "best")
    (tmp_path / "policies" / "pretrained").mkdir()
    assert trained_policies(own) == ["mine", "run"]
    for name in ("mine", "run"):
        assert load_policy(name, own).equals(read_network(trained, hsr))
    with pytest.raises(KinfeasError, match=f"{tmp_path}.*not a training run"):
        load_policy("pretrained", own)


def test_each_shipped_policy_is_complete(robot):
    folder = trained_folder("pretrained", robot)
    network = load_policy("pretrained", robot)
    assert network.equals(read_network(folder, robot))
    about = json.loads((folder / "policy.json").read_text())
    assert about["command"].startswith("kinfeas train ")
    assert {"config", "kinematics", "weights"} <= about.keys()
    assert pickle.loads(pickle.dumps(network)).equals(network)


def network(sizes=(28, 256, 256, 3), seed=0):
    rng = np.random.default_rng(seed)
    pairs = list(pairwise(sizes))
    return Network(
        rng.uniform(0.5, 2.0, sizes[0]).astype(np.float32),
        tuple((rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32) for pair in pairs),
        tuple(rng.normal(size=pair[1]).astype(np.float32) * np.float32(0.1) for pair in pairs),
    )


def observations(n, inputs=28, seed=1):
    return np.random.default_rng(seed).normal(size=(n, inputs))


@pytest.mark.parametrize("sizes", [(28, 3), (28, 7, 2), (28, 256, 256, 3), (26, 400, 300, 3)])
def test_is_a_perceptron(sizes):
    net, observation = network(sizes), observations(40, sizes[0])
    values = np.clip(observation * net.scale.astype(float), -CLIP, CLIP)
    for weight, bias in zip(net.weights[:-1], net.biases[:-1], strict=True):
        values = np.maximum(values @ weight.astype(float) + bias, 0.0)
    expected = np.tanh(values @ net.weights[-1].astype(float) + net.biases[-1])
    np.testing.assert_allclose(net(observation), expected, atol=1e-5)
    assert np.all(np.abs(net(observation * 100.0)) <= 1.0)


@pytest.mark.parametrize("size", [1, 3, 64])
def test_no_bit_depends_on_the_batch(size):
    net, observation = network(), observations(128)
    together = net(observation)
    for first in range(0, 128, size):
        rows = slice(first, first + size)
        np.testing.assert_array_equal(net(observation[rows]), together[rows])
    order = np.random.default_rng(2).permutation(128)
    np.testing.assert_array_equal(net(np.asfortranarray(observation[order])), together[order])
    assert (net(observation[:0]).shape, together.dtype) == ((0, 3), np.float64)


@pytest.mark.parametrize("layers", [2, 4, 10**9])
def test_as_many_layers_as_are_told_must_be_there(pr2, tmp_path, layers):
    write_network(network(), tmp_path, pr2, {})
    write_trained(replace(read_trained(tmp_path), layers=layers), tmp_path)
    with pytest.raises(KinfeasError, match=str(tmp_path)):
        read_network(tmp_path, pr2)


def test_damaged_weights_raise(hsr, trained):
    path = trained / "policy.safetensors"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(KinfeasError, match=f"{path}: is damaged"):
        load_policy(str(trained), hsr)


def test_a_policy_is_for_the_kinematics_that_it_was_trained_with(pr2, tmp_path):
    write_network(network(), tmp_path, pr2, {})
    assert read_trained(tmp_path).kinematics == fingerprint(pr2)
    faster = replace(pr2, base=replace(pr2.base, max_velocity=1.0))
    with pytest.raises(KinfeasError, match="kinematics"):
        read_network(tmp_path, faster)
    same = read_network(tmp_path, replace(pr2, pose_tolerance=None))
    np.testing.assert_array_equal(same(observations(9)), network()(observations(9)))


def test_terms_are_those_of_the_file(pr2, tmp_path):
    terms = ("goal_position", "joint_positions")
    net = replace(network((10, 8, 3)), observation_terms=terms)
    write_network(net, tmp_path, pr2, {})
    assert read_network(tmp_path, pr2).observation_terms == terms
    path = tmp_path / "policy.json"
    text = path.read_text()
    for key, name in (("observation", "goal_position"), ("action", "base_velocity")):
        path.write_text(text.replace(name, "lidar"))
        with pytest.raises(KinfeasError, match=rf"{key}.*lidar"):
            read_network(tmp_path, pr2)


def test_new_terms_of_a_widened_network_have_no_effect(hsr):
    old = random_network(hsr, width=8)
    old = replace(old, scale=2.0 * old.scale)  # of another version
    wide = old.widened(hsr, (*OBSERVATION, "previous_command"))
    np.testing.assert_array_equal(wide.scale[: len(old.scale)], old.scale)
    seen = np.random.default_rng(0).normal(size=(5, len(wide.scale)))
    np.testing.assert_array_equal(wide(seen), old(seen[:, : len(old.scale)]))
    with pytest.raises(KinfeasError):
        old.widened(hsr, OBSERVATION[::-1])
