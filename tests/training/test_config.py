from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.config.recipes import load_recipe, recipes
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.mark.parametrize("name", [*recipes("train"), *recipes("paper")])
def test_every_recipe_makes_a_world(name):
    recipe = load_recipe(TrainConfig, name, "train")
    task = load_task(recipe.task, recipe.task_parameters)
    World(load_robot(recipe.robot), task, recipe.world, recipe.seed)
    assert config.from_mapping(TrainConfig, config.to_mapping(recipe), "again") == recipe


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr", "td3"])
def test_recipes_of_the_paper_have_its_numbers(name):
    recipe = config.load(TrainConfig, CONFIGS / "paper" / f"{name}.yaml")
    learner, reward, schedule = recipe.learner, recipe.world.reward, recipe.schedule
    assert recipe.robot == ("pr2" if name == "td3" else name)
    assert (recipe.num_envs, learner.gradient_steps, recipe.task) == (1, 1, "ggr")
    assert (schedule.steps, schedule.minutes, learner.buffer_size) == (1_000_000, None, 100_000)
    assert (reward.failure, reward.limit_penalty, reward.jump_penalty) == ("indicator", 0.0, 0.0)
    td3 = learner.algorithm == "td3"
    assert td3 == (name == "td3")
    assert learner.net_arch == ((400, 300) if td3 else (256, 256))


@pytest.mark.parametrize(
    "override",
    [
        "learner.algorithm=ppo", "learner.gamma=1.5", "learner.net_arch=[0]", "num_envs=0",
        "learner.learning_rate=1.1", "action_repeat=1001", "seed=4294967296",
        "schedule.minutes=-1", "schedule.steps=null", "learner.batchsize=3", "processes=9",
    ],
)  # fmt: skip
def test_values_out_of_range_raise(tiny, override):
    with pytest.raises(KinfeasError, match=override.split("=")[0].split(".")[-1]):
        tiny(override)
