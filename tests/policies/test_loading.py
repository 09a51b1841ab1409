import json
import pickle

import numpy as np
import pytest

from kinfeas.benchmark.speed import random_network
from kinfeas.control.drive import action_size
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.policies.baselines import geometric_modulation
from kinfeas.policies.baselines.demonstrated_base import DemonstratedBase
from kinfeas.policies.baselines.follow_ee import FollowEe
from kinfeas.policies.baselines.geometric_modulation import GeometricModulation
from kinfeas.policies.baselines.whole_body_qp import WholeBodyQp
from kinfeas.policies.loading import BASELINES, QUICK_BASELINES, load_policy
from kinfeas.policies.network import write_network
from tests.policies.baselines.policy_inputs import policy_inputs


@pytest.fixture
def fitted(monkeypatch, ellipses):
    """Spare the baseline its fit."""
    monkeypatch.setattr(geometric_modulation, "fit_ellipses", lambda robot: ellipses)


@pytest.mark.parametrize("name", QUICK_BASELINES)
def test_quick_baselines_by_name(robot, name):
    assert load_policy(name, robot) == FollowEe(robot.base, feedback=name.endswith("feedback"))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("demonstrated_base", DemonstratedBase),
        ("geometric_modulation", GeometricModulation),
        ("whole_body_qp", WholeBodyQp),
    ],
)
def test_other_baselines_by_name(fitted, robot, name, kind):
    assert isinstance(load_policy(name, robot), kind)


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_survive_the_way_to_a_worker_process(fitted, robot, name):
    policy_input = policy_inputs(robot, 4)
    policy = load_policy(name, robot)
    action = policy.act(policy_input)
    assert action.shape == (4, action_size(robot.base))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(policy)).act(policy_input), action)


def test_a_trained_policy_by_its_folder(robot, tmp_path):
    network = random_network(robot, width=8)
    write_network(network, tmp_path, robot, {})
    seen = np.random.default_rng(0).normal(size=(3, len(network.scale)))
    np.testing.assert_array_equal(load_policy(str(tmp_path), robot)(seen), network(seen))


def test_an_unknown_name_lists_what_there_is(robot):
    with pytest.raises(KinfeasError, match=r"follow_ee, follow_ee_feedback.*training run"):
        load_policy("follow_me", robot)


def test_an_empty_name_is_not_the_folder_that_one_is_in(robot, tmp_path, monkeypatch):
    write_network(random_network(robot, width=8), tmp_path, robot, {})
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KinfeasError, match=r"name of the policy is empty; known are .*follow_ee"):
        load_policy("", robot)


def test_the_policy_that_comes_with_the_package(robot, tmp_path, monkeypatch):
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path)
    with pytest.raises(KinfeasError, match=f"no pretrained policy for robot '{robot.name}'"):
        load_policy("pretrained", robot)
    network = random_network(robot, width=8)
    (tmp_path / robot.name).mkdir()
    write_network(network, tmp_path / robot.name, robot, {})
    seen = np.random.default_rng(0).normal(size=(3, len(network.scale)))
    np.testing.assert_array_equal(load_policy("pretrained", robot)(seen), network(seen))


def test_what_can_be_no_policy(robot, tmp_path):
    (tmp_path / "empty.onnx").write_bytes(b"")
    with pytest.raises(KinfeasError, match=r"empty\.onnx: empty, and so not the ONNX file"):
        load_policy(str(tmp_path / "empty.onnx"), robot)
    with pytest.raises(KinfeasError, match=r"^/dev/null: neither the folder of a training run nor"):
        load_policy("/dev/null", robot)


def test_a_folder_that_is_no_run(robot, tmp_path):
    with pytest.raises(KinfeasError, match="not a training run"):
        load_policy(str(tmp_path), robot)


def test_a_broken_policy(robot, tmp_path):
    write_network(random_network(robot, width=8), tmp_path, robot, {})
    for path in tmp_path.glob("*.safetensors"):
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(KinfeasError, match="broken policy"):
        load_policy(str(tmp_path), robot)


def test_a_policy_of_another_robot(robot, tmp_path):
    write_network(random_network(robot, width=8), tmp_path, robot, {})
    (path,) = tmp_path.glob("*.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"robot": "other"}))
    with pytest.raises(KinfeasError, match="'other'"):
        load_policy(str(tmp_path), robot)
