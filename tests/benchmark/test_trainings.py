from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.benchmark.study import BenchmarkConfig, Training
from kinfeas.benchmark.trainings import settings_of, takes_pretrained, to_train
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained

OUT = Path("out")


def study(*overrides):
    return config.from_mapping(BenchmarkConfig, {}, "study", overrides)


TWO = ("robots=[pr2,hsr]", "trainings=[{robot: pr2, steps: 64}, {robot: pr2, algorithm: td3}]")


def test_a_run_for_each_training_and_seed():
    plans = to_train(study(*TWO, "robots=[pr2]", "seeds=[0,3]"), OUT)
    folders = [folder.name for _, folder in plans]
    assert folders == ["pr2-sac-0", "pr2-sac-3", "pr2-td3-0", "pr2-td3-3"]
    assert {folder.parent for _, folder in plans} == {OUT / "runs"}
    for settings, folder in plans:
        assert folder.name == f"{settings.robot}-{settings.learner.algorithm}-{settings.seed}"


def test_a_training_says_how():
    training = study(
        "robots=[pr2]",
        "trainings=[{robot: pr2, recipe: paper/td3, settings: ['num_envs=8'], minutes: 2}]",
    ).trainings[0]
    settings = settings_of(training, 5)
    assert (settings.seed, settings.num_envs, settings.learner.net_arch) == (5, 8, (400, 300))
    assert (settings.schedule.steps, settings.schedule.minutes) == (None, 2.0)
    # The entry, and not the recipe, says which algorithm.
    assert settings.learner.algorithm == "sac"


def test_a_robot_without_a_training_is_an_error():
    with pytest.raises(KinfeasError, match=r"no entry in 'trainings' for hsr; .*: pr2"):
        to_train(study(*TWO), OUT)


@pytest.mark.parametrize(
    "trainings",
    [
        "[{robot: pr2, steps: 64}, {robot: pr2, steps: 128}]",
        "[{robot: pr2, settings: [seed=5]}]",
    ],
)
def test_two_runs_of_one_folder_are_refused(trainings):
    twice = study("robots=[pr2]", f"trainings={trainings}", "seeds=[0, 5]")
    with pytest.raises(KinfeasError, match=r"two training runs pr2-sac-\d: robot, algorithm and"):
        to_train(twice, OUT)


def test_pretrained_policies_are_not_trained(monkeypatch):
    monkeypatch.setattr(pretrained, "robots", lambda root=None: ["hsr"])
    assert to_train(study(*TWO, "policies=pretrained"), OUT) == []
    either = study(*TWO, "policies=either")
    assert {settings.robot for settings, _ in to_train(either, OUT)} == {"pr2"}
    assert (takes_pretrained(either, "hsr"), takes_pretrained(either, "pr2")) == (True, False)
    assert not takes_pretrained(study(*TWO), "hsr")


def test_wrong_settings_of_a_training_are_named_as_such():
    with pytest.raises(KinfeasError, match=r"^the settings of the training of pr2: hldd=4:"):
        settings_of(Training(robot="pr2", settings=("hldd=4",)), 0)
