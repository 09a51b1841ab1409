from dataclasses import replace

import pytest

from kinfeas.config.recipes import load_recipe, load_section, recipes, section
from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.evaluate import EvalSettings
from kinfeas.policies.baselines.following import BaselineConfig
from kinfeas.sim2real.deploy.config import DeployConfig
from kinfeas.training.config import TrainConfig

SCHEMAS = {
    "train": TrainConfig,
    "train_physics": TrainConfig,
    "train_rooms": TrainConfig,
    "finetune_physics": TrainConfig,
    "analytic": EvalSettings,
    "pybullet": EvalSettings,
    "deploy": DeployConfig,
    "baselines": BaselineConfig,
}


@pytest.mark.parametrize("name", [name for part in SCHEMAS for name in recipes(part)])
def test_shipped_sections_are_valid(name):
    part, robot = name.split("/")
    assert load_section(SCHEMAS[part], part, robot)


def test_robot_file_changes_keys_of_the_default():
    default = section("train", "default")[0]
    tiago = load_section(TrainConfig, "train", "tiago")
    assert tiago.learner.net_arch == (256, 256, 256)
    assert tiago.world.ik.restarts == default["world"]["ik"]["restarts"]
    assert load_recipe(TrainConfig, "train/tiago", "train") == replace(tiago, robot="tiago")


@pytest.mark.parametrize("robot", ["no_such_robot", "../robots/pr2", "a/b"])
def test_robot_without_a_file_has_the_default(robot):
    assert section("train", robot)[0] == section("train", "default")[0]


@pytest.mark.parametrize("name", ["train/tiagoo", "nothing", "../pyproject", "", "/no.yaml", "."])
def test_unknown_name_is_an_error_with_the_known_ones(name):
    with pytest.raises(KinfeasError, match="train/tiago"):
        load_recipe(TrainConfig, name, "train")
