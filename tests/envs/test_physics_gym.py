import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import kinfeas.envs
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import WorldConfig

pytest.importorskip("pybullet")

from kinfeas.envs.physics import PhysicsSettings
from kinfeas.envs.physics_gym import PhysicsMotionEnv


def make(**arguments):
    return gymnasium.make(kinfeas.envs.PHYSICS_ENVIRONMENT, robot="hsr", **arguments)


@pytest.mark.filterwarnings("error")
def test_gymnasium_finds_nothing_wrong():
    assert kinfeas.envs.PHYSICS_ENVIRONMENT == "kinfeas/BaseMotionPyBullet-v0"
    env = make(render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()
    env.close()


def test_steps_tell_what_is_touched_and_pictures_show_the_robot():
    settings = PhysicsSettings(max_seconds=0.1)
    env = make(task="door", world=settings, render_mode="rgb_array")
    env.reset(seed=1)
    for last in (False, False, False, False, True):
        *_, truncated, info = env.step(np.zeros(3, dtype=np.float32))
        assert truncated == last
        assert (info["base_contacts"], info["arm_contacts"]) == (0, 0)
    picture = env.render()
    assert picture.shape == (360, 480, 3)
    assert picture.std() > 5.0
    env.close()


def test_a_picture_before_the_first_reset_is_refused():
    env = PhysicsMotionEnv("hsr", render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="call reset first"):
        env.render()
    env.close()


def test_films_run_at_the_control_rate():
    for dt, rate in ((0.02, 50), (0.1, 10)):
        env = PhysicsMotionEnv("hsr", world=PhysicsSettings(dt=dt))
        assert env.metadata["render_fps"] == rate
        env.close()


def test_every_observation_is_within_the_space():
    env = PhysicsMotionEnv("pr2")
    rng = np.random.default_rng(1)
    seen, _ = env.reset(seed=3)
    for _ in range(200):
        assert seen in env.observation_space
        seen, *_ = env.step(rng.uniform(-1.0, 1.0, 3).astype(np.float32))
    env.close()


def test_commands_are_carried_out_as_they_are_given():
    env = PhysicsMotionEnv("tiago")
    assert not env.world.loop.execution.feasibility_filter
    env.close()
    env = PhysicsMotionEnv("pr2")
    assert not env.world.loop.execution.min_obstacle_distance
    env.close()
    env = PhysicsMotionEnv(
        "tiago", world=PhysicsSettings(feasibility_filter=True, min_obstacle_distance=0.1)
    )
    assert env.world.loop.execution.feasibility_filter
    assert env.world.loop.execution.min_obstacle_distance == 0.1
    env.close()


def test_what_cannot_be_is_a_clear_error():
    with pytest.raises(KinfeasError, match="render_mode must be human, rgb_array or None"):
        PhysicsMotionEnv(render_mode="ansi")
    with pytest.raises(KinfeasError, match="unknown task"):
        PhysicsMotionEnv(task="fly")
    with pytest.raises(KinfeasError, match=r"^world must be PhysicsSettings or None, not 3$"):
        PhysicsMotionEnv(world=3)
    with pytest.raises(KinfeasError, match=r"^world must be PhysicsSettings or None, not World"):
        PhysicsMotionEnv(world=WorldConfig())
    with pytest.raises(KinfeasError, match=r"^reward must be RewardConfig or None, not 'dense'$"):
        PhysicsMotionEnv(reward="dense")


@pytest.mark.skipif(sys.platform != "linux", reason="a screen is named by DISPLAY on Linux")
def test_a_window_without_a_screen_is_a_clear_error(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":77")
    with pytest.raises(KinfeasError, match="PyBullet cannot open one on DISPLAY ':77'"):
        PhysicsMotionEnv(render_mode="human")
