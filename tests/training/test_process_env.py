"""Processes with PyBullet worlds; they take seconds to begin, so that few tests share them."""

import numpy as np
import pytest

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.training.config import TrainConfig
from kinfeas.training.train import resume, train

pytest.importorskip("pybullet")

from kinfeas.training.process_env import SHARE, ProcessVecEnv

PHYSICAL = {
    "robot": "hsr",
    "num_envs": 3,
    "processes": 2,
    "action_repeat": 5,
    "world": {"dt": 0.02, "max_seconds": 1.2, "max_failures": 99},
    "physics": {},
    "learner": {"batch_size": 16, "learning_starts": 40, "critic_steps": 40, "buffer_size": 500},
    "schedule": {
        "steps": 200,
        "minutes": None,
        "evaluations": 1,
        "evaluation_episodes": 1,
        "final_episodes": 1,
    },
}


def settings(*overrides):
    return config.from_mapping(TrainConfig, PHYSICAL, "physical", overrides)


@pytest.fixture(scope="module")
def env():
    env = ProcessVecEnv(settings())
    yield env
    env.close()


def run(env, steps):
    rng = np.random.default_rng(0)
    return [env.step(rng.uniform(-1, 1, (3, 3)).astype(np.float32)) for _ in range(steps)]


def test_episodes_end_and_begin_as_learners_want_it(env):
    seen = env.restore({"next_episode": np.arange(2) * SHARE})
    assert seen.shape == (3, env.observation_space.shape[0])
    assert len(np.unique(seen, axis=0)) == 3
    first = run(env, 13)
    after, rewards, dones, infos = first[11]  # 60 periods, 5 in an action
    assert dones.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert not np.array_equal(infos[0]["terminal_observation"], after[0])
    assert rewards.dtype == np.float32
    # The processes hold two rows and one, which have begun two episodes each.
    np.testing.assert_array_equal(env.snapshot()["next_episode"], np.arange(2) * SHARE + [4, 2])

    again = env.restore({"next_episode": np.arange(2) * SHARE})
    np.testing.assert_array_equal(again, seen)
    for one, other in zip(first, run(env, 13), strict=True):
        for a, b in zip(one[:3], other[:3], strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_snapshot_of_others_and_a_dead_process_are_clear_errors(env):
    with pytest.raises(ValueError, match="a snapshot of 3, not 2 processes"):
        env.restore({"next_episode": np.zeros(3, dtype=int)})
    with pytest.raises(ValueError, match=r"a snapshot whose next episodes are \[0, -1\]"):
        env.restore({"next_episode": np.array([0, -1])})
    with pytest.raises(RuntimeError, match="needs a step_async"):
        env.step_wait()
    env._processes[1].kill()
    env._processes[1].join()
    with pytest.raises(KinfeasError, match="one of 2 training processes died"):
        run(env, 2)


@pytest.mark.slow
def test_a_policy_is_tuned_judged_and_taken_up_again(tmp_path):
    out = tmp_path / "run"
    progress = train(settings("init=pretrained"), out)
    assert progress.steps == 210
    assert progress.evaluations == 2  # what it went on from was judged, too
    text = (out / "config.yaml").read_text()
    assert "init: pretrained" in text
    (out / "config.yaml").write_text(text.replace("steps: 200", "steps: 220"))
    assert resume(out).steps == 225
