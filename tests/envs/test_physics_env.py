from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from kinfeas.envs import PHYSICS_ENVIRONMENTS
from kinfeas.envs.world import evaluation_world


@pytest.fixture
def make(engine):
    return lambda robot="hsr", **arguments: gymnasium.make(
        PHYSICS_ENVIRONMENTS[engine], robot=robot, **arguments
    )


@pytest.mark.filterwarnings("error")
def test_gymnasium_finds_nothing_wrong(make):
    env = make(render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()


def test_steps_count_contacts_and_pictures_show_the_robot(make, engine):
    world = replace(evaluation_world(engine, "hsr"), max_seconds=0.1)
    env = make(task="door", world=world, render_mode="rgb_array")
    env.reset(seed=1)
    for last in (False, False, False, False, True):
        *_, truncated, info = env.step(np.zeros(3, dtype=np.float32))
        assert truncated == last
        assert (info["base_contacts"], info["arm_contacts"]) == (0, 0)
    assert env.unwrapped.metadata["render_fps"] == 50
    picture = env.render()
    assert picture.shape == (360, 480, 3)
    assert picture.std() > 5.0
    env.close()
