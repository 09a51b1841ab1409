import csv
import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from kinfeas.api.train import configure
from kinfeas.config.recipes import default_engine
from kinfeas.control.assemble import read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.training import train as training
from tests.builders import contents
from tests.cli.conftest import TINY, check_one_line
from tests.policy_cases import write_run

SHORT = ("train", "--robot", "hsr", "--steps", "64", "--out", "run", *TINY)


@pytest.mark.slow
def test_run_has_settings_metrics_and_the_evaluation_of_its_best_policy(kinfeas, tmp_path):
    changes = "--set", "world.filters=[feasibility]", "--set", "task_parameters.start=any"
    outcome = kinfeas(*SHORT, "--seed", "3", "--adapters", "harsh", *changes, code=0)
    (line,) = [line for line in outcome.out.splitlines() if "kinfeas evaluate" in line]
    expected = "kinfeas evaluate --robot hsr --task ggr --world analytic --policy run"
    expected += " --adapters harsh --set 'task.start=\"any\"'"
    assert line.partition(": ")[2] == expected
    run = tmp_path / "run"
    metrics = json.loads((run / "evaluation.json").read_text())
    assert (metrics["episodes"], metrics["steps"]) == (2, 64)
    assert metrics["success_low"] <= metrics["success"] <= metrics["success_high"]
    best = json.loads((run / "checkpoints" / "best" / "policy.json").read_text())
    assert metrics.items() >= best["fresh_evaluation"].items()
    settings = yaml.safe_load((run / "config.yaml").read_text())
    assert (settings["seed"], settings["schedule"]["steps"]) == (3, 64)
    assert settings["schedule"]["minutes"] is None
    names = [adapter["name"] for adapter in settings["world"]["adapters"]]
    assert names == metrics["adapters"] == [spec.name for spec in read_sim2real("harsh").adapters]
    assert metrics["filters"] == ["feasibility", "time_scaling"]
    assert settings["evaluation_adapters"] == settings["world"]["adapters"]
    with (run / "metrics.csv").open() as file:
        assert list(csv.DictReader(file))


def test_robot_and_recipe_by_path_and_default_folder(kinfeas, tmp_path):
    shutil.copytree(load_robot("hsr").folder, tmp_path / "mine")
    recipe = "robot: ./mine\nnum_envs: 8\nseed: 5\nworld: {dt: 0.05, max_failures: 9}\n"
    (tmp_path / "recipe.yaml").write_text(recipe)
    words = ("--config", "recipe.yaml", "--steps", "24", *TINY)
    outcome = kinfeas("train", *words, code=0)
    (line,) = [line for line in outcome.out.splitlines() if "kinfeas evaluate" in line]
    assert line.endswith("--policy runs/hsr-ggr-5 --set world.dt=0.05")
    settings = yaml.safe_load((tmp_path / "runs" / "hsr-ggr-5" / "config.yaml").read_text())
    assert settings["robot"] == str(tmp_path / "mine")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_run_can_be_resumed_and_extended(kinfeas, monkeypatch, number, code):
    steps, step = [], training._Run._step

    def interrupted(run):
        steps.append(step(run))
        if len(steps) == 3:
            signal.raise_signal(number)

    monkeypatch.setattr(training._Run, "_step", interrupted)
    outcome = kinfeas(*SHORT, code=code)
    state = json.loads(Path("run/checkpoints/last/state.json").read_text())
    assert state["progress"]["steps"] > 0
    assert outcome.err.splitlines()[-1].endswith("kinfeas train --resume run")
    shutil.copytree(load_robot("hsr").folder, "mine")
    kinfeas("train", "--resume", "run", "--steps", "128", "--robot", "./mine", code=0)
    settings = yaml.safe_load(Path("run/config.yaml").read_text())
    assert settings["schedule"]["steps"] == 128
    assert settings["robot"] == str(Path("mine").absolute())
    before = contents(Path("run"))
    check_one_line(kinfeas(*SHORT), "holds a run")
    assert contents(Path("run")) == before


def test_initial_policy_gives_robot_and_network(tmp_path):
    write_run(load_robot("hsr"), tmp_path, extra={"config": {"robot": "hsr"}})
    settings = configure(init=str(tmp_path))
    recipe = configure("hsr")
    learner = replace(recipe.learner, net_arch=(8, 8))
    assert settings == replace(recipe, init=str(tmp_path), learner=learner)
    assert configure(init=str(tmp_path), settings={"learner.net_arch": [8, 8]}) == settings
    for key, value in {"learner.net_arch": [32], "observation": ["ee_position"]}.items():
        with pytest.raises(KinfeasError, match=f"'{key}' is"):
            configure(init=str(tmp_path), settings={key: value})
    recipe_file = tmp_path / "recipe.yaml"
    recipe_file.write_text("robot: hsr\nlearner: {net_arch: [32]}\n")
    with pytest.raises(KinfeasError, match=r"'learner.net_arch' is"):
        configure(init=str(tmp_path), config=str(recipe_file))
    for other in ({"config": "paper/pr2"}, {"robot": "pr2"}):
        with pytest.raises(KinfeasError, match=r"'hsr'.*'pr2'"):
            configure(init=str(tmp_path), **other)


def test_options_win_over_the_recipe_and_set_over_both():
    settings = configure("tiago", seed=7, steps=5000, settings={"seed": 8, "num_envs": 4})
    assert (settings.seed, settings.num_envs) == (8, 4)
    assert (settings.schedule.steps, settings.schedule.minutes) == (5000, None)
    assert settings.learner.net_arch == (256, 256, 256)
    physics = configure("pr2", world=default_engine())
    assert (physics.world.backend, physics.world.time_scale) == (default_engine(), 0.5)
