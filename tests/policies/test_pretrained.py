import json
from pathlib import Path

import pytest

from kinfeas.benchmark.speed import random_network
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.policies.network import read_network, write_network
from kinfeas.robots.loading import load_robot


def made(root: Path, *names: str) -> Path:
    for name in names:
        robot = load_robot(name)
        (root / name).mkdir()
        write_network(random_network(robot, width=4), root / name, robot, {})
    return root


def test_a_robot_has_the_policy_in_its_folder(tmp_path):
    root = made(tmp_path, "pr2", "hsr")
    assert pretrained.robots(root) == ["hsr", "pr2"]
    assert pretrained.find("pr2", root) == tmp_path / "pr2"


def test_a_robot_without_one_is_told_who_has_one(tmp_path):
    root = made(tmp_path, "pr2", "hsr")
    with pytest.raises(KinfeasError, match=r"'tiago', only for: hsr, pr2; .*kinfeas train") as told:
        pretrained.find("tiago", root)
    # The name of a robot that was given by its path means nothing to other commands.
    assert "--robot tiago" not in str(told.value)
    with pytest.raises(KinfeasError, match="only for: none"):
        pretrained.find("tiago", tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["..", "pr2/..", ""])
def test_a_name_is_no_path(tmp_path, name):
    with pytest.raises(KinfeasError, match="no pretrained policy"):
        pretrained.find(name, made(tmp_path, "pr2"))


@pytest.mark.parametrize("name", pretrained.robots())
def test_each_shipped_policy_is_whole(name):
    folder = pretrained.find(name)
    assert read_network(folder, load_robot(name))
    about = json.loads((folder / "policy.json").read_text())
    assert about["command"].startswith("kinfeas train ")
    assert {"config", "seed", "benchmark", "evaluation"} <= about.keys()
