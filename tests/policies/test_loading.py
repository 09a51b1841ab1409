import json
import os
import pickle
import shutil
import sys
from dataclasses import replace

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.loading import BASELINES, load_policy, trained_folder, trained_policies
from kinfeas.policies.network import read_network, write_network
from kinfeas.testing import ConformanceError, check_policy
from tests.builders import random_network


@pytest.fixture
def trained(hsr, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    write_network(random_network(hsr, width=8), folder, hsr, {})
    return folder


LONG = {"geometric_modulation", "planner"}  # baselines that take long


@pytest.mark.parametrize("name", sorted({*BASELINES} - LONG))
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
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    check_policy(load_policy("my_policy:Still", hsr), hsr)
    with pytest.raises(ConformanceError, match=r"Loud.*\[-1, 1\]"):
        check_policy(load_policy("my_policy:Loud", hsr), hsr)
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
    assert load_policy("mine", own).equals(read_network(trained, hsr))


def test_each_shipped_policy_is_complete(robot):
    folder = trained_folder("pretrained", robot)
    network = load_policy("pretrained", robot)
    assert network.equals(read_network(folder, robot))
    about = json.loads((folder / "policy.json").read_text())
    assert about["command"].startswith("kinfeas train ")
    assert {"config", "kinematics"} <= about.keys()
    assert pickle.loads(pickle.dumps(network)).equals(network)
