import pickle
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common import env_checker as sb3_checker
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

from kinfeas import envs
from kinfeas.config import PluginSpec
from kinfeas.control.observation import OBSERVATION, TERMS
from kinfeas.core.errors import KinfeasError
from kinfeas.envs import PHYSICS_ENVIRONMENTS
from kinfeas.envs.gym import BaseMotionVectorEnv
from kinfeas.envs.world import WorldConfig, evaluation_world, step_info
from kinfeas.viz.gym import BaseMotionEnv

NOISY = WorldConfig(
    max_seconds=4.0, max_failures=5, adapters=(PluginSpec("base_noise", {"linear": 0.05}),)
)
SEED = 7
BOTH = pytest.mark.parametrize("kind", [BaseMotionEnv, BaseMotionVectorEnv])


def test_gymnasium_and_sb3_find_nothing_wrong():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("kinfeas.envs:kinfeas/BaseMotion-v0", robot="hsr")
        check_env(env.unwrapped)
        sb3_checker.check_env(env.unwrapped)


def test_gymnasium_makes_both_by_name():
    envs.register()  # a second time changes nothing
    assert isinstance(gymnasium.make("kinfeas/BaseMotion-v0").unwrapped, BaseMotionEnv)
    name, mode = "kinfeas/BaseMotion-v0", "vector_entry_point"
    vector = gymnasium.make_vec(
        name, num_envs=3, vectorization_mode=mode, robot="hsr", render_mode=None
    )
    assert isinstance(vector.unwrapped, BaseMotionVectorEnv)
    single = BaseMotionEnv("hsr")
    assert vector.unwrapped.single_observation_space == single.observation_space
    assert vector.unwrapped.single_action_space == single.action_space
    assert vector.reset(seed=0)[0] in vector.observation_space


@pytest.mark.slow
def test_processes_of_sb3_make_the_environment_by_its_name():
    parts = {"vec_env_cls": SubprocVecEnv, "vec_env_kwargs": {"start_method": "spawn"}}
    name, robot = "kinfeas.envs:kinfeas/BaseMotion-v0", {"robot": "hsr"}
    many = make_vec_env(name, 2, seed=SEED, env_kwargs=robot, **parts)
    observations = many.reset()
    many.close()
    for row, observation in enumerate(observations):
        np.testing.assert_array_equal(observation, BaseMotionEnv("hsr").reset(seed=SEED + row)[0])


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr", "ridgeback_ur5"])
def test_every_observation_is_within_the_space(name):
    noise = PluginSpec("joint_noise", {"deviation": 0.02})
    noisy = WorldConfig(max_failures=999, adapters=(noise,))
    for config, terms in ((WorldConfig(), OBSERVATION), (noisy, tuple(TERMS))):
        env = BaseMotionVectorEnv(32, name, "ggr_obstacles", config, observation=terms)
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(60):
            seen, *_ = env.step(env.action_space.sample())
            assert seen in env.observation_space


def begin(env, number):
    """Begin an episode of the seed; return its first observation."""
    starts = [env.reset(seed=SEED if episode == 0 else None) for episode in range(number + 1)]
    assert starts[-1][1] == {"episode_number": number}
    return starts[-1][0]


def test_an_episode_is_the_same_alone_and_beside_others():
    vector, alone = BaseMotionVectorEnv(3, "hsr", world=NOISY), BaseMotionEnv("hsr", world=NOISY)
    first, _ = vector.reset(seed=SEED)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 3, 3)).astype(np.float32)
    steps, ended = [vector.step(action) for action in actions], []
    for row in range(3):
        np.testing.assert_array_equal(begin(alone, row), first[row])
        for action, (seen, reward, terminated, truncated, infos) in zip(
            actions, steps, strict=True
        ):
            found, *rest, info = alone.step(action[row])
            done = terminated[row] or truncated[row]
            last = infos["final_obs"][row] if done else seen[row]
            np.testing.assert_array_equal(found, last)
            assert rest == [reward[row], terminated[row], truncated[row]]
            assert infos["_feasible"][row] == (not done)
            if done:
                ended.append(int(infos["episode_number"][row]))
                final = infos["final_info"].items()
                assert info == {key: values[row] for key, values in final if key[0] != "_"}
                np.testing.assert_array_equal(begin(alone, ended[-1]), seen[row])
    assert len(set(ended)) == len(ended) > 3


def test_a_copy_by_pickle_continues_the_episode():
    env = BaseMotionEnv("hsr", world={"dt": 0.05, "filters": ["feasibility"]})
    assert env.world.config == WorldConfig(dt=0.05, filters=(PluginSpec("feasibility"),))
    env.reset(seed=SEED)
    copy = pickle.loads(pickle.dumps(env))
    action = env.action_space.sample()
    np.testing.assert_array_equal(copy.step(action)[0], env.step(action)[0])


def test_a_reset_without_a_seed_takes_the_next_episodes():
    env = BaseMotionVectorEnv(2, "hsr")
    first, _ = env.reset(seed=1)
    later, infos = env.reset()
    assert infos["episode_number"].tolist() == [2, 3]
    wide, _ = BaseMotionVectorEnv(4, "hsr").reset(seed=1)
    np.testing.assert_array_equal(np.concatenate([first, later]), wide)
    np.testing.assert_array_equal(env.reset(seed=1)[0], first)


@BOTH
def test_seeds_are_random_at_first_and_actions_need_an_episode(kind):
    one, two = (kind(robot="hsr") for _ in range(2))
    with pytest.raises(ResetNeeded):
        one.step(one.action_space.sample())
    assert not np.array_equal(one.reset()[0], two.reset()[0])
    one.np_random = np.random.default_rng(3)
    with pytest.raises(KinfeasError, match="seed"):
        one.reset()


@BOTH
def test_actions_are_finite_numbers_of_their_shape(kind):
    env = kind(robot="hsr")
    env.reset(seed=0)
    shape = env.action_space.shape
    for wrong in (np.zeros(2), np.zeros((9, 3)), np.full(shape, np.nan), np.zeros(())):
        with pytest.raises(KinfeasError, match=r"the action (has shape|is not finite)") as caught:
            env.step(wrong)
        assert wrong.shape == shape or f"{wrong.shape}, not {shape}" in str(caught.value)


@pytest.mark.parametrize("arguments", [
    {"robot": None}, {"world": 3}, {"world": {"DT": 1}}, {"render_mode": "ansi"},
    {"render_mode": "human", "backend": "analytic"}, {"observation": ["sight"]},
], ids=list)  # fmt: skip
def test_wrong_arguments_are_named(arguments):
    with pytest.raises(KinfeasError, match=next(iter(arguments))):
        BaseMotionEnv(**arguments)
    with pytest.raises(KinfeasError, match="num_envs"):
        BaseMotionVectorEnv(0)


@pytest.mark.parametrize(("reached", "failures"), [(True, 0), (True, 1), (False, 0)])
def test_success_is_a_goal_reached_without_a_failure(reached, failures):
    world = BaseMotionEnv("hsr").world
    world.start([0])
    transition = replace(world.step(np.zeros((1, 3))), reached=np.array([reached]))
    world.failures[:] = failures
    info = step_info(world, transition)
    assert (info["reached"], info["failures"]) == (reached, failures)
    assert info["is_success"] == (reached and not failures)


@pytest.fixture
def make(engine):
    return lambda robot="hsr", **arguments: gymnasium.make(
        PHYSICS_ENVIRONMENTS[engine], robot=robot, **arguments
    )


@pytest.mark.filterwarnings("error")
def test_gymnasium_finds_nothing_wrong_with_physics(make):
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
