import re

import numpy as np
import pytest
from stable_baselines3 import SAC

from kinfeas.config import PluginSpec
from kinfeas.control.observation import CLIP, scaled
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.training.vec_env import WorldVecEnv

NOISY = WorldConfig(max_seconds=1.2, max_failures=3, adapters=(PluginSpec("base_noise"),))


def make(robot, n, config=NOISY, seed=4):
    return WorldVecEnv(World(robot, registry.build("kinfeas.tasks", "ggr", {}), config, seed), n)


def actions(env, rng):
    return rng.uniform(-1.0, 1.0, (env.num_envs, env.world.action_size)).astype(np.float32)


def run(env, steps, seed=0):
    rng = np.random.default_rng(seed)
    return [env.step(actions(env, rng)) for _ in range(steps)]


def assert_equal(one, other):
    """Check that two runs are equal to the bit, infos too."""
    for mine, others in zip(one, other, strict=True):
        for a, b in zip(mine[:3], others[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        assert repr(mine[3]) == repr(others[3])


def test_observations_are_the_worlds_scaled(robot):
    env = make(robot, 3)
    seen = env.reset()
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen, scaled(env.world.loop.observation, env.scale))
    assert np.abs(seen).max() <= CLIP


def test_terminal_observation_is_the_last_one_before_the_restart(robot):
    n = 4
    env, beside = make(robot, n), make(robot, n).world
    env.reset()
    beside.start(range(n))
    rng, ended, following = np.random.default_rng(0), 0, n
    for _ in range(40):
        action = actions(env, rng)
        seen, rewards, dones, infos = env.step(action)
        expected = beside.step(action.astype(np.float64))
        np.testing.assert_array_equal(dones, expected.done)
        np.testing.assert_array_equal(rewards, expected.reward.astype(np.float32))
        for row in range(n):
            last = scaled(expected.observation[row], env.scale)
            if dones[row]:
                info = infos[row]
                np.testing.assert_array_equal(info["terminal_observation"], last)
                assert not np.array_equal(seen[row], last)
                assert info["TimeLimit.truncated"] == expected.truncated[row]
                assert info["failures"] == beside.failures[row]
                assert info["is_success"] == (expected.reached[row] and info["failures"] == 0)
                ended += 1
            else:
                np.testing.assert_array_equal(seen[row], last)
                assert infos[row] == {}
        rows = np.flatnonzero(dones)
        if rows.size:
            beside.start(range(following, following + rows.size), rows)
            following += rows.size
    assert ended > n


def test_a_time_limit_truncates_and_a_failure_does_not(robot):
    env = make(robot, 16, WorldConfig(max_seconds=0.6, max_failures=1))
    env.reset()
    kinds = set()
    for _, _, dones, infos in run(env, 30):
        for row in np.flatnonzero(dones):
            truncated = infos[row]["TimeLimit.truncated"]
            assert truncated == (infos[row]["failures"] <= 1 and not infos[row]["is_success"])
            kinds.add(truncated)
    assert kinds == {True, False}


def test_goes_on_from_a_snapshot_to_the_bit(robot):
    env = make(robot, 5)
    env.reset()
    run(env, 17)
    snapshot = {key: values.copy() for key, values in env.snapshot().items()}
    kept = env.snapshot()
    expected = run(env, 30, seed=1)
    for key, values in snapshot.items():
        np.testing.assert_array_equal(kept[key], values, err_msg=f"{key} changed afterwards")
    fresh = make(robot, 5)
    seen = fresh.restore(snapshot)
    assert_equal(run(fresh, 30, seed=1), expected)
    np.testing.assert_array_equal(env.restore(snapshot), seen)
    assert_equal(run(env, 30, seed=1), expected)


def test_noise_goes_on_too(robot):
    """Without its state the restored run would be another one."""
    env = make(robot, 2)
    env.reset()
    run(env, 3)
    snapshot = env.snapshot()
    expected = run(env, 2, seed=1)
    env.restore({**snapshot, "BaseNoise.0.steps": snapshot["BaseNoise.0.steps"] + np.uint64(1)})
    assert not np.array_equal(run(env, 2, seed=1)[-1][0], expected[-1][0])


def test_a_snapshot_of_another_size_is_refused(robot):
    env = make(robot, 3)
    env.reset()
    with pytest.raises(ValueError, match="a snapshot of 3, not 4 episodes"):
        make(robot, 4).restore(env.snapshot())


def test_a_seed_begins_anew(robot):
    env = make(robot, 3)
    first = env.reset()
    later = env.reset()
    assert not np.array_equal(first, later)
    assert env.seed(4) == [4, 4, 4]
    np.testing.assert_array_equal(env.reset(), first)
    env.seed(5)
    assert not np.array_equal(env.reset(), first)


def test_sb3_can_learn_in_it_by_itself(robot):
    env = make(robot, 4)
    policy = {"net_arch": [8]}
    learner = SAC("MlpPolicy", env, learning_starts=40, batch_size=8, policy_kwargs=policy)
    learner.learn(120)
    assert learner.num_timesteps == 120
    assert learner.ep_success_buffer
    env.close()


def test_the_environments_are_one(robot):
    env = make(robot, 2)
    assert env.get_attr("num_envs") == [2, 2]
    assert env.env_is_wrapped(object) == [False, False]
    with pytest.raises(AttributeError):
        env.get_attr("nothing")
    with pytest.raises(NotImplementedError):
        env.set_attr("world", None)
    with pytest.raises(NotImplementedError):
        env.env_method("reset")


def test_an_action_holds_and_earns_the_mean_until_its_episode_ends(robot):
    """As many steps of the world with the same action; what ends begins anew after the last."""
    n, action_repeat = 4, 5
    env = WorldVecEnv(
        World(robot, registry.build("kinfeas.tasks", "ggr", {}), NOISY, 4), n, action_repeat
    )
    beside = make(robot, n).world
    env.reset()
    beside.start(range(n))
    rng, early, following = np.random.default_rng(0), 0, n
    for _ in range(20):
        action = actions(env, rng)
        seen, rewards, dones, infos = env.step(action)
        earned, lasts = [[] for _ in range(n)], [None] * n
        for _ in range(action_repeat):
            expected = beside.step(action.astype(np.float64))
            for row in range(n):
                if lasts[row] is None:
                    earned[row].append(expected.reward[row])
                if lasts[row] is None and expected.done[row]:
                    lasts[row] = expected.observation[row]
                    assert infos[row]["TimeLimit.truncated"] == expected.truncated[row]
                    assert infos[row]["failures"] == beside.failures[row]
                    early += len(earned[row]) < action_repeat
        ended = [row for row in range(n) if lasts[row] is not None]
        if ended:
            beside.start(range(following, following + len(ended)), np.array(ended))
            following += len(ended)
        np.testing.assert_array_equal(np.flatnonzero(dones), ended)
        np.testing.assert_allclose(rewards, [np.mean(row) for row in earned], rtol=1e-6)
        np.testing.assert_array_equal(seen, scaled(beside.loop.observation, env.scale))
        for row in ended:
            last = scaled(lasts[row], env.scale)
            np.testing.assert_array_equal(infos[row]["terminal_observation"], last)
    assert early > 0


def test_actions_that_are_none_are_refused(robot):
    env = make(robot, 2)
    env.reset()
    size = env.world.action_size
    for shape in ((1, size), (2, size + 1), (size,)):
        with pytest.raises(KinfeasError, match=re.escape(f"not of shape {shape}")):
            env.step_async(np.zeros(shape))
    with pytest.raises(KinfeasError, match="not NaN or infinite"):
        env.step_async(np.full((2, size), np.nan))
    assert np.isfinite(env.step(np.zeros((2, size)))[0]).all()


def test_no_episodes_are_refused(robot):
    with pytest.raises(KinfeasError, match="num_envs must be at least 1, not 0"):
        make(robot, 0)
