import pytest

from kinfeas import config
from kinfeas.config.recipes import load_recipe, recipes
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig


@pytest.mark.parametrize("name", [*recipes("train"), *recipes("paper")])
def test_every_recipe_makes_a_world(name):
    recipe = load_recipe(TrainConfig, name, "train")
    task = load_task(recipe.task, recipe.task_parameters)
    World(load_robot(recipe.robot), task, recipe.world, recipe.seed)
    assert config.from_mapping(TrainConfig, config.to_mapping(recipe), "again") == recipe


@pytest.mark.parametrize(
    "override",
    ["learner.algorithm=ppo", "learner.gamma=1.5", "schedule.steps=null", "processes=9"],
)
def test_values_out_of_range_raise(tiny, override):
    with pytest.raises(KinfeasError, match=override.split("=")[0].split(".")[-1]):
        tiny(override)
