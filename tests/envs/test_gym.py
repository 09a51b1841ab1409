import os
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RenderCollection
from stable_baselines3.common import env_checker as sb3_checker

from kinfeas import envs
from kinfeas.config import PluginSpec
from kinfeas.control.observation import scaled
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.gym import BaseMotionEnv
from kinfeas.envs.vector import BaseMotionVectorEnv
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.training.vec_env import WorldVecEnv

NOISY = WorldConfig(
    max_seconds=4.0, max_failures=5, adapters=(PluginSpec("base_noise", {"linear": 0.05}),)
)
SEED, EPISODES = 7, 8


@pytest.fixture(params=["pr2", "tiago", "hsr"])
def name(request):
    return request.param


def command(step: int, size: int) -> np.ndarray:
    """Return an action that depends on the number of the step in its episode alone."""
    return np.sin(step * np.arange(1, size + 1), dtype=np.float32)


def trace_single(name: str) -> dict[int, bytes]:
    """Return all that is seen and earned in each episode of one environment, as bytes."""
    env = BaseMotionEnv(name, world=NOISY)
    traces = {}
    for episode in range(EPISODES):
        seen, info = env.reset(seed=SEED if episode == 0 else None)
        assert info == {"episode_number": episode}
        trace, step, done = [seen.tobytes()], 0, False
        while not done:
            action = command(step, env.world.action_size)
            seen, reward, terminated, truncated, info = env.step(action)
            trace += [seen.tobytes(), np.float64(reward).tobytes()]
            step, done = step + 1, terminated or truncated
        traces[episode] = b"".join([*trace, repr((terminated, truncated, info)).encode()])
    return traces


def trace_vector(name: str, n: int) -> dict[int, bytes]:
    """Return the same of n episodes side by side."""
    env = BaseMotionVectorEnv(n, name, world=NOISY)
    seen, infos = env.reset(seed=SEED)
    number, steps = infos["episode_number"].copy(), np.zeros(n, dtype=int)
    traces = {k: [seen[row].tobytes()] for row, k in enumerate(number)}
    whole = {}
    while len(whole) < EPISODES:
        actions = np.stack([command(step, env.world.action_size) for step in steps])
        seen, rewards, terminated, truncated, infos = env.step(actions)
        steps += 1
        for row in range(n):
            done = terminated[row] or truncated[row]
            last = infos["final_obs"][row] if done else seen[row]
            traces[number[row]] += [last.tobytes(), rewards[row].tobytes()]
            if done:
                final = infos["final_info"]
                info = {k: v[row].item() for k, v in final.items() if not k.startswith("_")}
                ended = repr((bool(terminated[row]), bool(truncated[row]), info)).encode()
                if number[row] < EPISODES:
                    whole[int(number[row])] = b"".join([*traces[number[row]], ended])
                number[row], steps[row] = infos["episode_number"][row], 0
                traces[number[row]] = [seen[row].tobytes()]
    return whole


def test_gymnasium_and_sb3_find_nothing_to_complain_of(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("kinfeas.envs:kinfeas/BaseMotion-v0", robot=name)
        check_env(env.unwrapped)
        sb3_checker.check_env(env.unwrapped)


def test_gymnasium_makes_it_by_name():
    envs.register()  # a second time changes nothing
    assert isinstance(gymnasium.make("kinfeas/BaseMotion-v0").unwrapped, BaseMotionEnv)
    vector = gymnasium.make_vec("kinfeas/BaseMotion-v0", num_envs=3, robot="hsr")
    assert isinstance(vector.unwrapped, BaseMotionVectorEnv)
    assert vector.reset(seed=0)[0].shape == vector.observation_space.shape


def test_shows_what_the_world_sees(name):
    env = BaseMotionEnv(name, "ggr_restricted", task_parameters={"orientation": "so3"})
    seen, _ = env.reset(seed=3)
    assert env.world.task.orientation == "so3"
    world = World(env.world.robot, env.world.task, WorldConfig(), 3)
    np.testing.assert_array_equal(seen, world.start([0])[0].astype(np.float32))
    assert seen in env.observation_space
    np.testing.assert_array_equal(env.action_space.high, np.ones(world.action_size))


def test_what_adapters_measure_lies_in_the_space(name):
    noise = PluginSpec("joint_noise", {"deviation": 0.02})
    env = BaseMotionEnv(name, world=WorldConfig(max_failures=999, adapters=(noise,)))
    lower, upper = env.world.robot.finite_joint_limits
    seen, beyond = env.reset(seed=0)[0], 0
    for _ in range(400):
        assert seen in env.observation_space
        joints = seen[-len(lower) :]
        beyond += bool(((joints < lower) | (joints > upper)).any())
        seen, *_ = env.step(np.zeros(env.action_space.shape))
    assert beyond


def test_every_observation_is_within_the_space(name):
    env = BaseMotionVectorEnv(32, name)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(60):
        seen, *_ = env.step(env.action_space.sample())
        assert seen in env.observation_space


def test_an_episode_is_the_same_alone_and_beside_others(name):
    single = trace_single(name)
    assert len(set(single.values())) == EPISODES
    assert trace_vector(name, 3) == single
    assert trace_vector(name, 1) == single


def test_an_episode_is_the_same_in_the_training_adapter(name):
    n = 3
    robot, task = load_robot(name), registry.build("kinfeas.tasks", "ggr", {})
    env = WorldVecEnv(World(robot, task, NOISY, SEED), n)
    size = env.world.action_size
    seen, step = env.reset(), 0
    singles = [BaseMotionEnv(name, world=NOISY) for _ in range(n)]
    for skipped, single in enumerate(singles):
        first = single.reset(seed=SEED)[0]
        for _ in range(skipped):
            first = single.reset()[0]
        np.testing.assert_array_equal(scaled(first, env.scale), seen[skipped])
    running = set(range(n))
    while running:
        seen, rewards, dones, infos = env.step(np.tile(command(step, size), (n, 1)))
        for row in sorted(running):
            alone, reward, terminated, truncated, info = singles[row].step(command(step, size))
            here = infos[row]["terminal_observation"] if dones[row] else seen[row]
            np.testing.assert_array_equal(scaled(alone, env.scale), here)
            assert (np.float32(reward), terminated or truncated) == (rewards[row], dones[row])
            if dones[row]:
                assert infos[row]["TimeLimit.truncated"] == truncated
                assert infos[row]["failures"] == info["failures"]
                running.remove(row)
        step += 1


def test_an_episode_is_the_same_in_another_process():
    code = f"""
import runpy
module = runpy.run_path({__file__!r})
print({{k: v.hex() for k, v in module["trace_single"]("pr2").items()}} )
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True,
        env={**os.environ, "PYTHONHASHSEED": "99"},
    )  # fmt: skip
    expected = {k: v.hex() for k, v in trace_single("pr2").items()}
    assert done.stdout.strip() == repr(expected)


def test_time_limit_truncates_and_does_not_terminate():
    env = BaseMotionEnv(world=WorldConfig(max_seconds=0.3, max_failures=100))
    env.reset(seed=0)
    ends = [env.step(np.zeros(3, dtype=np.float32))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_too_many_failures_terminate_and_do_not_truncate():
    # The very step that would be the last one: a failure is not mistaken for the time limit.
    env = BaseMotionEnv(world=WorldConfig(max_failures=4))
    env.reset(seed=0)
    terminated = truncated = False
    steps = 0
    while not (terminated or truncated):
        _, _, terminated, truncated, info = env.step(np.array([-1.0, 0.0, 1.0]))
        steps += 1
    assert (terminated, truncated, info["failures"], info["is_success"]) == (True, False, 5, False)
    limited = BaseMotionEnv(world=WorldConfig(max_failures=4, max_seconds=steps / 10))
    limited.reset(seed=0)
    for _ in range(steps):
        end = limited.step(np.array([-1.0, 0.0, 1.0]))
    assert end[2:4] == (True, False)


def test_success_is_told():
    # The goal lies where the arm begins.
    near = {"distance": [0.3, 0.6], "heights": [0.6, 0.9]}
    env = BaseMotionEnv(task_parameters=near, world=WorldConfig(max_failures=0))
    outcomes = set()
    for _ in range(30):
        env.reset(seed=0 if not outcomes else None)
        done = False
        while not done:
            _, _, terminated, truncated, info = env.step(np.zeros(3))
            done = terminated or truncated
        assert terminated == (info["reached"] or info["failures"] > 0)
        assert info["is_success"] == (info["reached"] and info["failures"] == 0)
        outcomes.add(info["is_success"])
    assert outcomes == {True, False}


def test_a_seed_may_be_a_number_of_numpy():
    env = BaseMotionEnv()
    np.testing.assert_array_equal(env.reset(seed=np.int64(3))[0], env.reset(seed=3)[0])


@pytest.mark.parametrize("seed", [[1], "1", 1.0])
def test_refuses_what_is_no_seed(seed):
    with pytest.raises(KinfeasError, match="seed must be one number"):
        BaseMotionEnv().reset(seed=seed)


@pytest.mark.parametrize("kind", [BaseMotionEnv, BaseMotionVectorEnv])
def test_a_source_of_randomness_in_place_of_a_seed_is_refused(kind):
    env = kind()
    env.np_random = np.random.default_rng(3)
    with pytest.raises(KinfeasError, match=r"set the seed by reset\(seed=...\)"):
        env.reset()


def test_resets_without_a_seed_begin_somewhere_else():
    first, second = (BaseMotionEnv().reset()[0] for _ in range(2))
    assert not np.array_equal(first, second)


@pytest.mark.parametrize(
    "action", [np.zeros(2), np.zeros((1, 3)), np.array([0.0, np.nan, 0.0]), np.zeros(())]
)
def test_refuses_what_is_no_action(action):
    env = BaseMotionEnv()
    env.reset(seed=0)
    with pytest.raises(KinfeasError, match=r"finite numbers of shape \(3,\)"):
        env.step(action)


def test_an_error_on_an_action_says_its_shape_and_not_its_numbers():
    env = BaseMotionEnv()
    env.reset(seed=0)
    with pytest.raises(KinfeasError, match=r"shape \(3,\), not of shape \(100, 3\)$"):
        env.step(np.zeros((100, 3)))


@pytest.mark.parametrize("kind", [BaseMotionEnv, BaseMotionVectorEnv])
def test_a_step_before_the_first_reset_is_refused(kind):
    env = kind()
    with pytest.raises(ResetNeeded, match="call reset first"):
        env.step(env.action_space.sample())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": None}, "robot must be one of .*pr2.* or the path of a YAML file, not None"),
        ({"task": None}, "task must be one of .*ggr.* or the path of a YAML file, not None"),
        ({"robot": "pr3"}, "unknown robot 'pr3'"),
        ({"task": "dance"}, "unknown task 'dance'"),
        ({"task_parameters": {"distnce": [1, 2]}}, "distnce"),
        ({"world": WorldConfig(adapters=(PluginSpec("fog"),))}, "unknown adapter 'fog'"),
    ],
)
def test_refuses_what_there_is_not(arguments, message):
    with pytest.raises(KinfeasError, match=message):
        BaseMotionEnv(**arguments)


def test_an_episode_can_be_looked_at():
    options = {"robot": "hsr", "world": WorldConfig(dt=0.2)}
    env = gymnasium.make("kinfeas/BaseMotion-v0", render_mode="rgb_array", **options)
    check_env(env.unwrapped)
    assert env.unwrapped.metadata["render_fps"] == 5
    env = RenderCollection(env)
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.ones(3, dtype=np.float32))
    first, *_, last = env.render()
    assert first.shape == (360, 480, 3)
    assert first.dtype == np.uint8
    assert (first != last).any()
    with pytest.raises(KinfeasError):
        gymnasium.make("kinfeas/BaseMotion-v0", render_mode="ansi", **options)
    bare = gymnasium.make("kinfeas/BaseMotion-v0", **options)
    bare.reset()
    assert bare.unwrapped.render() is None
