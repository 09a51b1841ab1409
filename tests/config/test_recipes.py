from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.benchmark.study import read_benchmark
from kinfeas.benchmark.trainings import to_train
from kinfeas.config.recipes import default_recipe, find_recipe, recipes
from kinfeas.core.errors import KinfeasError
from kinfeas.training.config import TrainConfig


@pytest.mark.parametrize("name", recipes("train"))
def test_shipped_training_recipes_are_valid(name):
    assert config.load(TrainConfig, find_recipe(name, "train"))


def test_a_name_with_and_without_its_suffix():
    assert find_recipe("train/default", "train") == find_recipe("train/default.yaml", "train")


def test_a_path_wins(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("seed: 3\n")
    assert find_recipe(str(own), "train") == own


@pytest.mark.parametrize("name", ["train/defalt", "nothing", "../pyproject", "", "/no.yaml"])
def test_an_unknown_name_says_what_there_is(name):
    with pytest.raises(KinfeasError, match="train/default"):
        find_recipe(name, "train")


@pytest.mark.parametrize("robot", ["no_such_robot", "../train/default", "a/b"])
def test_a_robot_without_its_own_takes_the_default(robot):
    assert default_recipe("train", robot).name == "default.yaml"


@pytest.mark.parametrize("name", ["benchmark/study", "benchmark/quick"])
def test_shipped_studies_are_valid(name):
    study = read_benchmark(name)
    for settings, _ in to_train(study, Path("out")):
        assert settings.task == "ggr"
