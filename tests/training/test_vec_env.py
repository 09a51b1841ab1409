from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.config import PluginSpec
from kinfeas.control.observation import scaled
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import resume, train
from kinfeas.training.vec_env import SHARE, ProcessVecEnv, WorldVecEnv

NOISY = WorldConfig(max_seconds=1.2, max_failures=3, adapters=(PluginSpec("base_noise"),))


def make(n, config=NOISY, action_repeat=1):
    return WorldVecEnv(World(load_robot("hsr"), load_task("ggr"), config, 4), n, action_repeat)


def actions(env, rng):
    return rng.uniform(-1.0, 1.0, (env.num_envs, *env.action_space.shape)).astype(np.float32)


def run(env, steps, seed=0):
    rng = np.random.default_rng(seed)
    return [env.step(actions(env, rng)) for _ in range(steps)]


def assert_equal(one, other):
    for mine, others in zip(one, other, strict=True):
        for a, b in zip(mine[:3], others[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        assert repr(mine[3]) == repr(others[3])


@pytest.mark.parametrize("repeat", [1, 5])
def test_steps_are_the_worlds_repeated_with_the_mean_reward_until_the_end(repeat):
    n = 4
    env, beside = make(n, action_repeat=repeat), make(n).world
    np.testing.assert_array_equal(env.reset(), scaled(beside.start(range(n)), env.scale))
    rng, following, early, truncations = np.random.default_rng(0), n, 0, set()
    for _ in range(100 // repeat):
        action = actions(env, rng)
        seen, rewards, dones, infos = env.step(action)
        earned, lasts = [[] for _ in range(n)], [None] * n
        for _ in range(repeat):
            expected = beside.step(action.astype(np.float64))
            for row in range(n):
                if lasts[row] is not None:
                    continue
                earned[row].append(expected.reward[row])
                if expected.done[row]:
                    lasts[row] = expected.observation[row]
                    failures = beside.failures[row]
                    assert infos[row]["TimeLimit.truncated"] == expected.truncated[row]
                    assert infos[row]["failures"] == failures
                    assert infos[row]["is_success"] == (expected.reached[row] and failures == 0)
                    truncations.add(bool(expected.truncated[row]))
                    early += len(earned[row]) < repeat
        ended = [row for row in range(n) if lasts[row] is not None]
        if ended:
            beside.start(range(following, following + len(ended)), np.array(ended))
            following += len(ended)
        np.testing.assert_array_equal(np.flatnonzero(dones), ended)
        np.testing.assert_allclose(rewards, [np.mean(row) for row in earned], rtol=1e-6)
        np.testing.assert_array_equal(seen, scaled(beside.loop.observation.values, env.scale))
        for row in range(n):
            if row in ended:
                last = scaled(lasts[row], env.scale)
                np.testing.assert_array_equal(infos[row]["terminal_observation"], last)
            else:
                assert infos[row] == {}
    assert following > 2 * n
    assert truncations == {True, False}
    assert (early > 0) == (repeat > 1)


PHYSICAL = {
    "robot": "hsr",
    "num_envs": 3,
    "processes": 2,
    "action_repeat": 5,
    "world": {"backend": "pybullet", "dt": 0.02, "max_seconds": 0.6, "max_failures": 99},
    "learner": {"batch_size": 16, "learning_starts": 40, "critic_steps": 40, "buffer_size": 500},
    "schedule": {"steps": 200, "minutes": None, "evaluations": 1, "evaluation_episodes": 1}
    | {"final_episodes": 1},
}


def test_filters_with_a_memory_begin_the_next_episodes():
    config = replace(NOISY, adapters=(), filters=(PluginSpec("path_planner"),))
    env = make(2, config)
    env.reset()
    run(env, 2)
    snapshot = env.snapshot()
    assert list(snapshot) == ["next_episode"]
    other = make(2, config)
    seen = other.restore(snapshot)
    np.testing.assert_array_equal(seen, scaled(env.batch.start(), env.scale))
    assert_equal(run(other, 2), run(env, 2))


def physical(settings=None):
    return config.from_mapping(TrainConfig, PHYSICAL, "physical", settings)


@pytest.mark.slow
def test_processes_hold_batches_that_restart_and_a_killed_one_raises():
    pytest.importorskip("pybullet")
    env = ProcessVecEnv(physical())
    seen = env.reset()
    assert len(np.unique(seen, axis=0)) == 3
    first = run(env, 7)
    after, rewards, dones, infos = first[5]  # 30 periods, 5 in an action
    assert dones.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert not np.array_equal(infos[0]["terminal_observation"], after[0])
    assert rewards.dtype == np.float32
    # The processes hold two rows and one, which have begun two episodes each.
    np.testing.assert_array_equal(env.snapshot()["next_episode"], np.arange(2) * SHARE + [4, 2])
    again = env.restore({"next_episode": np.arange(2) * SHARE})
    np.testing.assert_array_equal(again, seen)
    assert_equal(run(env, 7), first)
    env.seed(5)
    other = ProcessVecEnv(physical({"seed": 5}))
    np.testing.assert_array_equal(env.reset(), other.reset())
    assert_equal(run(env, 2), run(other, 2))
    other.close()

    (process,) = env._workers[1]._processes.values()
    process.kill()
    with pytest.raises(KinfeasError, match="processes died"):
        run(env, 2)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_policy_is_tuned_in_physics_and_resumed(tmp_path, engine):
    pytest.importorskip(engine)
    out = tmp_path / "run"
    progress = train(physical({"init": "pretrained", "world.backend": engine}), out)
    assert progress.steps == 210
    assert progress.evaluations == 2  # the initial policy is evaluated, too
    assert resume(out, settings={"schedule.steps": 220}).steps == 225
