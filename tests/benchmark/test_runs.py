import shutil

import pytest

from kinfeas import config
from kinfeas.benchmark.runs import find_runs, finish, is_missing, read_run
from kinfeas.core.errors import KinfeasError
from kinfeas.training import train as training
from kinfeas.training.config import TrainConfig
from tests.training.conftest import TINY


def tiny(*overrides):
    return config.from_mapping(TrainConfig, TINY, "tiny", ["schedule.steps=400", *overrides])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "pr2-sac-0"
    finish(tiny(), folder)
    return folder


def test_a_run_is_read(run):
    found = read_run(run)
    assert (found.robot, found.algorithm, found.seed, found.task) == ("pr2", "sac", 0, "ggr")


def test_a_run_on_a_task_by_path_goes_by_its_name(tmp_path):
    config.dump(tiny("task=/my/fetch.yaml"), tmp_path / "config.yaml")
    assert read_run(tmp_path).task == "fetch"


def test_a_finished_run_is_not_trained_again(run):
    assert not is_missing(tiny(), run)


def test_a_run_is_found_by_itself_and_below_a_folder(run):
    assert find_runs([run]) == find_runs([run.parent]) == find_runs([run, run]) == [read_run(run)]


def test_two_runs_of_one_seed_are_an_error(run, tmp_path):
    shutil.copytree(run, tmp_path / "other")
    with pytest.raises(KinfeasError, match="both hold pr2 learned by sac with seed 0"):
        find_runs([run, tmp_path])


def test_a_folder_that_is_no_run(tmp_path):
    with pytest.raises(KinfeasError, match="not a training run"):
        find_runs([tmp_path])


def test_a_run_of_other_settings_is_not_taken(run):
    with pytest.raises(KinfeasError, match="another 'seed' than the study's: 0 instead of 1"):
        is_missing(tiny("seed=1"), run)


def test_an_interrupted_run_is_taken_up(tmp_path, monkeypatch):
    folder, steps, step = tmp_path / "run", [], training._Run._step
    assert is_missing(tiny(), folder)

    def interrupted(one):
        steps.append(step(one))
        if len(steps) == 20:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training._Run, "_step", interrupted)
        finish(tiny(), folder)
    assert is_missing(tiny(), folder)
    finish(tiny(), folder)
    assert not is_missing(tiny(), folder)
