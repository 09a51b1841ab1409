import json
import shlex
from dataclasses import replace

import pytest

from kinfeas import config
from kinfeas.benchmark.publish import publish, train_command
from kinfeas.benchmark.runs import Run
from kinfeas.benchmark.speed import random_network
from kinfeas.cli.train import read_settings
from kinfeas.core.errors import KinfeasError
from kinfeas.io.policy_metadata import read_trained, write_trained
from kinfeas.policies import pretrained
from kinfeas.policies.network import read_network, write_network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import fingerprint
from kinfeas.training.config import TrainConfig


def made(folder, seed, success):
    robot = load_robot("pr2")
    settings = config.from_mapping(TrainConfig, {"seed": seed}, "made")
    best = folder / f"run-{seed}" / "checkpoints" / "best"
    best.mkdir(parents=True)
    figures = {"episodes": 9, "success": success, "success_low": 0.0, "success_high": 1.0}
    about = {"config": config.to_mapping(settings), "steps": 9, "evaluation": figures}
    write_network(random_network(robot, width=4 + seed), best, robot, about)
    return Run(folder / f"run-{seed}", "pr2", "sac", seed, "ggr")


def test_the_best_seed_is_published(tmp_path):
    runs = [made(tmp_path, seed, success) for seed, success in enumerate((0.8, 0.9, 0.9))]
    figures = {runs[1].folder: {"ggr": {"success": 0.91}}}
    target = tmp_path / "pretrained"
    for _ in "twice":
        assert publish(runs, figures, target) == {"pr2": target / "pr2"}
    assert pretrained.find("pr2", target) == target / "pr2"
    robot = load_robot("pr2")
    network = read_network(target / "pr2", robot)
    assert network.weights[0].shape[1] == 5
    about = json.loads((target / "pr2" / "policy.json").read_text())
    assert about["seed"] == about["config"]["seed"] == 1
    assert about["kinematics"] == fingerprint(robot)
    assert about["benchmark"] == {"ggr": {"success": 0.91}}
    assert about["command"].startswith("kinfeas train --robot pr2 --seed 1")
    assert sorted(path.name for path in target.iterdir()) == ["pr2"]


def test_a_run_without_a_policy_is_an_error(tmp_path):
    run = made(tmp_path, 0, 0.9)
    best = run.folder / "checkpoints" / "best"
    write_trained(replace(read_trained(best), evaluation={}), best)
    with pytest.raises(KinfeasError, match="best: not the best checkpoint"):
        publish([run], {}, tmp_path / "out")
    (best / "policy.json").write_text("[" * 200_000)
    with pytest.raises(KinfeasError, match=r"best/policy\.json: broken JSON"):
        publish([run], {}, tmp_path / "out")


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["robot=hsr", "seed=4", "schedule.steps=2000", "schedule.minutes=null"],
        ["learner.algorithm=td3", "learner.net_arch=[400, 300]", "world.adapters=[]"],
        ["world.adapters=[{name: base_noise, parameters: {linear: 0.15}}]", "task=door"],
    ],
)
def test_the_command_makes_the_same_settings(overrides):
    settings = config.from_mapping(TrainConfig, {}, "test", overrides)
    words = shlex.split(train_command(settings))
    assert words[:2] == ["kinfeas", "train"]
    options = list(zip(words[2::2], words[3::2], strict=True))
    given = dict(options[:2])
    assert {key for key, _ in options[2:]} <= {"--set"}
    changes = [value for _, value in options[2:]]
    again = read_settings(given["--robot"], seed=int(given["--seed"]), overrides=changes)
    assert again == settings
