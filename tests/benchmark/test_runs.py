import json
import shutil
from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.benchmark.evaluations import TrainedRun, find_runs, plan_runs, publish, read_run
from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import training_job
from kinfeas.policies.network import read_network, write_network
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig
from tests.benchmark.benchmark_cases import study
from tests.builders import TRAINING, random_network

OUT = Path("out")
TINY = TRAINING | {"robot": "hsr", "schedule.steps": 64, "schedule.minutes": None}


def tiny(settings=None):
    return config.from_mapping(TrainConfig, config.nested(TINY, settings), "tiny")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    training_job(tiny(), folder).run()
    return folder


def test_runs_are_found_and_not_trained_again(run, tmp_path):
    trained = read_run(run)
    assert (trained.robot, trained.seed) == ("hsr", tiny().seed)
    assert find_runs([run]) == find_runs([run.parent]) == find_runs([run, run]) == [trained]
    assert training_job(tiny(), run).result()["robot"] == "hsr"
    with pytest.raises(KinfeasError, match="tiny"):
        training_job(tiny({"seed": 77}), run)
    shutil.copytree(run, tmp_path / "other")
    assert [found.label for found in find_runs([run, tmp_path])] == ["other", "tiny"]
    shutil.copytree(run, tmp_path / "tiny")
    with pytest.raises(KinfeasError, match="tiny"):
        find_runs([run, tmp_path])
    with pytest.raises(KinfeasError, match=r"config\.yaml"):
        find_runs([tmp_path / "none"])


def test_settings_of_a_training():
    entry = {"robot": "pr2", "recipe": "paper/pr2", "settings": {"num_envs": 8}, "minutes": 2}
    (job,) = plan_runs(study({"robots": ["pr2"], "trainings": [entry], "seeds": [5]}), OUT)
    settings, _ = job.description
    assert (settings.seed, settings.num_envs, settings.learner.ent_coef) == (5, 8, "learned")
    assert (settings.schedule.steps, settings.schedule.minutes) == (None, 2.0)


def made(folder, seed, success):
    robot, settings = load_robot("hsr"), tiny({"seed": seed})
    best = folder / f"run-{seed}" / "checkpoints" / "best"
    best.mkdir(parents=True)
    metrics = {"episodes": 9, "success": success, "success_low": 0.0, "success_high": 1.0}
    about = {"config": config.to_mapping(settings), "steps": 9, "evaluation": metrics}
    write_network(random_network(robot, width=4 + seed), best, robot, about)
    return TrainedRun(folder / f"run-{seed}", "hsr", seed, "ggr")


def test_the_best_seed_is_published(tmp_path):
    runs = [made(tmp_path, seed, success) for seed, success in enumerate((0.8, 0.9, 0.9))]
    target = tmp_path / "pretrained"
    for _ in range(2):
        assert publish(runs, target) == [target / "hsr"]
    assert read_network(target / "hsr", load_robot("hsr")).weights[0].shape[1] == 5
    about = json.loads((target / "hsr" / "policy.json").read_text())
    assert about["seed"] == about["config"]["seed"] == 1
    (runs[0].folder / "checkpoints/best/policy.json").unlink()
    with pytest.raises(KinfeasError, match="run-0"):
        publish(runs[:1], tmp_path / "none")
