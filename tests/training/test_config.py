from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.config.recipes import load_recipe, recipes
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.robots.loading import load_robot
from kinfeas.training.config import TrainConfig

CONFIGS = Path(__file__).parents[2] / "configs"
RECIPES = [*recipes("train"), *recipes("paper")]
PAPER = [CONFIGS / "paper" / f"{name}.yaml" for name in ("pr2", "tiago", "hsr", "td3")]


def load(path):
    return config.load(TrainConfig, path)


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_loads_and_makes_a_world(name):
    recipe = load_recipe(TrainConfig, name, "train")
    robot = load_robot(recipe.robot)
    task = registry.build("kinfeas.tasks", recipe.task, recipe.task_parameters)
    assert World(robot, task, recipe.world, recipe.seed).start([0]).shape[0] == 1
    assert config.from_mapping(TrainConfig, config.to_mapping(recipe), "again") == recipe


@pytest.mark.parametrize("path", PAPER, ids=lambda path: path.stem)
def test_the_papers_numbers(path):
    recipe = load(path)
    learner, reward, schedule = recipe.learner, recipe.world.reward, recipe.schedule
    assert (recipe.num_envs, learner.gradient_steps, recipe.task) == (1, 1, "ggr")
    assert (schedule.steps, schedule.minutes, learner.buffer_size) == (1_000_000, None, 100_000)
    assert (reward.failure, reward.limit_penalty, reward.jump_penalty) == ("indicator", 0.0, 0.0)
    assert reward.action_penalty in {0.0, 0.01, 0.1}
    assert recipe.world.max_failures in {1, 19, 99}
    assert learner.batch_size in {64, 256}
    assert learner.learning_rate in {3e-4, 1e-4, 1e-5}
    assert learner.tau in {0.001, 0.005}
    assert learner.gamma in {0.98, 0.99, 0.999}
    assert learner.learning_starts in {0, 50_000}
    if learner.algorithm == "td3":
        assert learner.net_arch == (400, 300)
        assert learner.exploration_noise in {0.25, 0.5, 0.75}
        assert learner.policy_noise in {0.1, 0.25, 0.5}
    else:
        assert learner.net_arch == (256, 256)
        assert learner.ent_coef in {"learned", 0.1, 0.2, 0.3}


@pytest.mark.parametrize("robot", ["pr2", "tiago", "hsr"])
def test_the_papers_robots(robot):
    recipe = load(CONFIGS / "paper" / f"{robot}.yaml")
    assert (recipe.robot, recipe.learner.algorithm) == (robot, "sac")


def test_sturdy_noise_differs_from_the_default_in_the_noise_alone():
    names = ("paper/sturdy_noise", "train/default")
    sturdy, default = (load_recipe(TrainConfig, name, "train") for name in names)
    assert sturdy.world.adapters[0].parameters["linear"] == 0.15
    assert sturdy.learner == default.learner
    assert sturdy.world.reward == default.world.reward


def test_each_process_has_an_environment(tiny):
    with pytest.raises(KinfeasError, match="'processes' must be at most 'num_envs', 8, not 9"):
        tiny("physics={}", "num_envs=8", "processes=9")


def test_a_run_without_an_end_is_refused(tiny):
    with pytest.raises(KinfeasError, match="one of 'steps' and 'minutes' must be set"):
        tiny("schedule.steps=null")


@pytest.mark.parametrize(
    "override",
    [
        "learner.algorithm=ppo", "learner.gamma=1.5", "learner.net_arch=[0]", "num_envs=0",
        "learner.net_arch=[2049]", "learner.net_arch=[8,8,8,8,8,8,8,8,8]",
        "learner.learning_rate=1.1",
        "learner.batch_size=99999999", "learner.gradient_steps=99999999", "num_envs=65537",
        "action_repeat=1001", "schedule.evaluations=99999", "schedule.evaluation_episodes=99999999",
        "seed=4294967296",
        "learner.learning_rate=0", "schedule.minutes=-1", "seed=-1", "learner.batchsize=3",
    ],
)  # fmt: skip
def test_what_is_out_of_range_is_refused(tiny, override):
    with pytest.raises(KinfeasError, match=override.split("=")[0].split(".")[-1]):
        tiny(override)
