import csv
import json
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
import yaml

from kinfeas.cli.train_settings import Wishes, read_settings
from kinfeas.control.adapters import read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.training import train as training
from tests.cli.conftest import TINY, is_one_line
from tests.sim2real.policy_cases import write_run


@pytest.fixture
def run_folder(kinfeas, tmp_path):
    assert kinfeas("train", "--steps", "64", "--out", "run", *TINY).code == 0
    return tmp_path / "run"


def test_a_run_leaves_what_it_says(kinfeas, tmp_path):
    outcome = kinfeas("train", "--steps", "64", "--seed", "3", "--out", "run", *TINY)
    assert outcome.code == 0, outcome.err
    assert "kinfeas evaluate --robot pr2 --task ggr --policy run" in outcome.out
    run = tmp_path / "run"
    figures = json.loads((run / "evaluation.json").read_text())
    assert figures["episodes"] == 2
    assert figures["steps"] == 64
    assert figures["success_low"] <= figures["success"] <= figures["success_high"]
    best = json.loads((run / "checkpoints" / "best" / "policy.json").read_text())
    assert figures.items() >= best["fresh_evaluation"].items()
    settings = yaml.safe_load((run / "config.yaml").read_text())
    assert (settings["seed"], settings["schedule"]["steps"]) == (3, 64)
    assert settings["schedule"]["minutes"] is None
    with (run / "metrics.csv").open() as file:
        assert list(csv.DictReader(file))


def test_the_folder_is_named_after_the_run(kinfeas, tmp_path):
    arguments = ("--robot", "tiago", "--task", "ggr_restricted", "--algorithm", "td3")
    assert kinfeas("train", *arguments, "--seed", "5", "--steps", "32", *TINY).code == 0
    settings = tmp_path / "runs" / "tiago-ggr_restricted-5" / "config.yaml"
    assert yaml.safe_load(settings.read_text())["learner"]["algorithm"] == "td3"


def test_a_robot_by_path_and_a_recipe_by_path(kinfeas, tmp_path):
    from kinfeas.robots import pr2

    for file in (pr2(), pr2().with_suffix(".urdf")):
        shutil.copy(file, tmp_path / file.name)
    (tmp_path / "recipe.yaml").write_text("robot: ./pr2.yaml\nnum_envs: 8\n")
    outcome = kinfeas("train", "--config", "recipe.yaml", "--steps", "16", "--out", "run", *TINY)
    assert outcome.code == 0, outcome.err
    assert f"--robot {tmp_path / 'pr2.yaml'}" in outcome.out


def test_resume_of_a_finished_run_shows_it_and_does_no_harm(kinfeas, run_folder):
    (run_folder / "evaluation.json").unlink()  # a kill may have come before it
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    outcome = kinfeas("train", "--resume", "run")
    assert outcome.code == 0
    assert outcome.err == ("run: finished; more --steps or --minutes in all take it further\n")
    assert "kinfeas evaluate --robot pr2 --task ggr --policy run" in outcome.out
    assert json.loads((run_folder / "evaluation.json").read_text())["steps"] == 64
    (run_folder / "evaluation.json").unlink()
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before


def test_a_finished_run_is_shown_without_torch(run_folder):
    code = """
import sys
from kinfeas.cli.main import main
try:
    main()
finally:
    print("torch" in sys.modules)
"""
    command = [sys.executable, "-c", code, "train", "--resume", "run"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=run_folder.parent
    )
    assert done.stdout.endswith("--policy run\nFalse\n")


def test_a_finished_run_that_lost_its_best_policy_is_one_line(kinfeas, run_folder):
    shutil.rmtree(run_folder / "checkpoints" / "best")
    outcome = kinfeas("train", "--resume", "run")
    assert is_one_line(outcome), outcome.err
    assert "not a training run or checkpoint: there is no run/policy.json" in outcome.err


def test_a_longer_schedule_takes_a_finished_run_further(kinfeas, run_folder):
    before = (run_folder / "config.yaml").read_text()
    # No less than it has done.
    assert "finished" in kinfeas("train", "--resume", "run", "--steps", "32").err
    assert (run_folder / "config.yaml").read_text() == before
    outcome = kinfeas("train", "--resume", "run", "--steps", "128")
    assert outcome.code == 0, outcome.err
    assert "128" in outcome.out
    assert "finished" not in outcome.err
    assert (run_folder / "config.yaml").read_text() == before.replace("steps: 64", "steps: 128")


def test_interruption_says_how_to_go_on(kinfeas, monkeypatch):
    steps = []
    step = training._Run._step

    def interrupted(run):
        steps.append(step(run))
        if len(steps) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(training._Run, "_step", interrupted)
    outcome = kinfeas("train", "--steps", "64", "--out", "run", *TINY)
    assert outcome.code == 130
    assert outcome.err.splitlines()[-1].endswith("kinfeas train --resume run")
    assert "Traceback" not in outcome.err
    assert kinfeas("train", "--resume", "run").code == 0


def test_interruption_before_the_run_begins_promises_nothing(kinfeas, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(training._Run, "__init__", interrupted)
    outcome = kinfeas("train", "--steps", "64", "--out", "run", *TINY)
    assert outcome.code == 130
    assert outcome.err.splitlines()[-1] == "interrupted before the run began: nothing was kept"
    assert not (tmp_path / "run").exists()


def test_adapters_of_a_list_take_the_place_of_the_recipes(kinfeas, tmp_path):
    outcome = kinfeas("train", "--steps", "64", "--out", "run", "--adapters", "harsh", *TINY)
    assert outcome.code == 0, outcome.err
    settings = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())
    named = [adapter["name"] for adapter in settings["world"]["adapters"]]
    assert named == [adapter.name for adapter in read_sim2real("harsh").adapters]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--robot", "pr3"), "unknown robot 'pr3'"),
        (("--robot", "none/robot.yaml"), "none/robot.yaml"),
        (("--task", "fly"), "unknown task 'fly'"),
        (("--config", "train/none"), "train/default"),
        (("--adapters", "hars"), "did you mean 'harsh'"),
        (("--config", "../pyproject"), "../pyproject: there is no such file; known by name are"),
        (("--set", "learner.lerning_rate=1"), "did you mean 'learning_rate'"),
        (("--set", "learner.batch_size=0"), ">= 1"),
        (("--set", "world.adapters=[{name: nois}]"), "unknown adapter 'nois'"),
        (("--set", "nonsense"), "key=value"),
        (("--minutes", "0"), "> 0"),
        (("--steps", "-3"), ">= 1"),
        (("--seed", "-1"), ">= 0"),
        (("--algorithm", "ppo"), "'sac', 'td3'"),
        (("--minutes", "0"), "error: --minutes: must be a number > 0"),
        (("--minutes", "0"), "> 0, not 0.0"),
        (("--seed", "4294967296"), "Invalid value for '--seed'"),
        (("--minutes", "nan"), "error: --minutes: must be a number > 0"),
        (("--steps", "0"), "error: --steps: must be a whole number >= 1"),
        (("--seed", "-1"), "error: --seed: must be a whole number >= 0"),
        (("--algorithm", "ppo"), "error: --algorithm: must be one of 'sac', 'td3', not 'ppo'"),
        (("--set", "num_envs=99999999999"), "'num_envs' must be a whole number in [1, 65"),
        (("--set", "learner.net_arch=[1000000,1000000]"), "whole number in [1, 2048]"),
        (("--set", "learner.net_arch=[8,8,8,8,8,8,8,8,8]"), "must have at most 8 entries, not 9"),
        (("--set", "learner.learning_rate=1.5"), "must be a number in (0, 1], not 1.5"),
        (("--world", "pybullet", "--processes", "257"), "less than or equal to 256"),
        (("--processes", "2"), "needs --world pybullet"),
        (("--init", "follow_ee", "--steps", "8"), "nothing else has weights to go on from"),
        (("--init", "nowhere"), "error: init: nowhere: neither the folder of a training run"),
        (("--world", "pybullet", "--config", "train/default"), "a recipe without 'physics'"),
        (("--config", "train_physics/default"), "needs --world pybullet"),
        (("--resume", "nowhere"), "not a training run"),
        (("--resume", "nowhere", "--seed", "1"), "leave out"),
    ],
)
def test_bad_input_is_one_line(kinfeas, tmp_path, arguments, words):
    outcome = kinfeas("train", *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
    assert not (tmp_path / "runs").exists()


def test_a_folder_that_cannot_be_written_is_one_line(kinfeas, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = kinfeas("train", "--out", "file/run", "--steps", "8", *TINY)
    assert is_one_line(outcome), outcome.err
    assert "cannot be written" in outcome.err


def test_a_run_is_not_overwritten(kinfeas, run_folder):
    outcome = kinfeas("train", "--steps", "64", "--out", "run", *TINY)
    assert is_one_line(outcome), outcome.err
    assert "--resume run" in outcome.err


@pytest.mark.parametrize(
    ("option", "place", "end"),
    [
        ("--out", "run", "use --resume run, or another --out"),
        ("--out", ".", "holds other files, --out needs a new or an empty folder"),
        ("--out", "run/config.yaml/below", "cannot be written: Not a directory"),
        ("--resume", ".", "there is no config.yaml in it"),
    ],
)
def test_a_wrong_folder_is_refused_before_torch_is_imported(tmp_path, option, place, end):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").touch()
    code = """
import sys
from kinfeas.cli.main import main
try:
    main()
finally:
    print("heavy:", {"torch", "numba"} & set(sys.modules))
"""
    command = [sys.executable, "-c", code, "train", option, place]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "heavy: set()\n")
    assert done.stderr.endswith(f"{end}\n")


def test_a_run_goes_on_from_a_policy_with_its_robot(tmp_path):
    write_run(load_robot("hsr"), tmp_path, extra={"config": {"robot": "hsr"}})
    settings = read_settings(Wishes(init=str(tmp_path)), None, [])
    recipe = read_settings(Wishes("hsr"), None, [])
    learner = replace(recipe.learner, net_arch=(8, 8))
    assert settings == replace(recipe, init=str(tmp_path), learner=learner)
    for wishes, recipe in ((Wishes(), "train/pr2"), (Wishes("pr2"), None)):
        with pytest.raises(KinfeasError, match=r"for robot 'hsr' .* but robot 'pr2' has"):
            read_settings(replace(wishes, init=str(tmp_path)), recipe, [])


def test_a_broken_checkpoint_is_one_line(kinfeas, run_folder):
    state = run_folder / "checkpoints" / "last" / "state.safetensors"
    state.write_bytes(state.read_bytes()[:100])
    settings = run_folder / "config.yaml"
    settings.write_text(settings.read_text().replace("steps: 64", "steps: 128"))
    assert is_one_line(kinfeas("train", "--resume", "run"))
