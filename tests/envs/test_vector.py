import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from kinfeas.core.errors import KinfeasError
from kinfeas.envs.gym import BaseMotionEnv
from kinfeas.envs.vector import BaseMotionVectorEnv
from kinfeas.envs.world import WorldConfig

SHORT = WorldConfig(max_seconds=0.4, max_failures=1)


def run(env, steps):
    """Return the results of some steps of a random but fixed policy."""
    rng = np.random.default_rng(0)
    return [
        env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
        for _ in range(steps)
    ]


def test_spaces_are_those_of_the_single_environment_n_times():
    single, vector = BaseMotionEnv("hsr"), BaseMotionVectorEnv(5, "hsr")
    assert vector.single_observation_space == single.observation_space
    assert vector.single_action_space == single.action_space
    assert vector.observation_space.shape == (5, *single.observation_space.shape)
    assert vector.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    seen, _ = vector.reset(seed=0)
    assert seen in vector.observation_space


def test_infos_are_laid_out_as_gymnasiums_own():
    """Beside a vector of single environments, which has the same keys, types and masks."""
    options = {
        "robot": "pr2", "world": SHORT, "num_envs": 3,
        "vector_kwargs": {"autoreset_mode": AutoresetMode.SAME_STEP},
    }  # fmt: skip
    theirs = gymnasium.make_vec("kinfeas/BaseMotion-v0", vectorization_mode="sync", **options)
    ours = BaseMotionVectorEnv(3, world=SHORT)
    theirs.reset(seed=0)
    ours.reset(seed=0)
    for mine, other in zip(run(ours, 9), run(theirs, 9), strict=True):
        for i in range(4):
            assert mine[i].dtype == other[i].dtype
            assert mine[i].shape == other[i].shape
        if mine[2].any() == other[2].any() and mine[3].any() == other[3].any():
            assert set(mine[4]) >= {k for k in other[4] if "episode_number" not in k}
        for key in set(mine[4]) & set(other[4]) - {"final_info"}:
            assert mine[4][key].dtype == other[4][key].dtype, key


def test_who_ends_begins_anew_in_the_same_step():
    env = BaseMotionVectorEnv(3, world=SHORT)
    _, infos = env.reset(seed=5)
    assert infos["episode_number"].tolist() == [0, 1, 2]
    following = 3
    for seen, _, terminated, truncated, infos in run(env, 20):
        done = terminated | truncated
        assert not (terminated & truncated).any()
        np.testing.assert_array_equal(infos["_feasible"], ~done)
        if not done.any():
            assert "final_obs" not in infos
            continue
        np.testing.assert_array_equal(infos["_final_obs"], done)
        np.testing.assert_array_equal(infos["_final_info"], done)
        np.testing.assert_array_equal(infos["final_info"]["_is_success"], done)
        for row in np.flatnonzero(done):
            assert infos["episode_number"][row] == following
            single = BaseMotionEnv(world=SHORT)
            single.reset(seed=5)
            single.next_episode = following
            np.testing.assert_array_equal(single.reset()[0], seen[row])
            assert infos["final_obs"][row] in env.single_observation_space
            assert not np.array_equal(infos["final_obs"][row], seen[row])
            following += 1
        assert all(infos["final_obs"][row] is None for row in np.flatnonzero(~done))
    assert following > 6


def test_truncation_is_told_apart_from_termination():
    env = BaseMotionVectorEnv(8, world=WorldConfig(max_seconds=0.3, max_failures=0))
    env.reset(seed=0)
    results = run(env, 3)
    failed = [infos["final_info"]["failures"][t] for _, _, t, _, infos in results if t.any()]
    assert failed
    assert all((failures == 1).all() for failures in failed)
    _, _, _, truncated, infos = results[-1]
    assert truncated.any()
    assert (infos["final_info"]["failures"][truncated] == 0).all()


def test_a_reset_without_a_seed_takes_the_next_episodes():
    env = BaseMotionVectorEnv(2)
    first, _ = env.reset(seed=1)
    later, infos = env.reset()
    assert infos["episode_number"].tolist() == [2, 3]
    wide, _ = BaseMotionVectorEnv(4).reset(seed=1)
    np.testing.assert_array_equal(np.concatenate([first, later]), wide)
    np.testing.assert_array_equal(env.reset(seed=1)[0], first)


def test_a_first_reset_without_a_seed_draws_one():
    first, second = (BaseMotionVectorEnv(2).reset()[0] for _ in range(2))
    assert not np.array_equal(first, second)


def test_what_was_returned_does_not_change_later():
    env = BaseMotionVectorEnv(3, world=SHORT)
    env.reset(seed=0)
    result = run(env, 1)[0]
    kept = [np.array(part) for part in result[:4]] + [result[4]["failures"].copy()]
    run(env, 6)
    for before, after in zip(kept, [*result[:4], result[4]["failures"]], strict=True):
        np.testing.assert_array_equal(before, after)


def test_gymnasiums_wrappers_work():
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        gymnasium.make_vec("kinfeas/BaseMotion-v0", num_envs=3, world=SHORT)
    )
    env.reset(seed=0)
    lengths = []
    for *_, infos in run(env, 10):
        if "episode" in infos:
            lengths += infos["episode"]["l"][infos["_episode"]].tolist()
    assert lengths
    assert max(lengths) <= 4
    env.close()


@pytest.mark.parametrize("seed", [[1, 2], "1", 1.0])
def test_refuses_a_seed_for_each_row(seed):
    with pytest.raises(KinfeasError, match="one number for all episodes"):
        BaseMotionVectorEnv(2).reset(seed=seed)


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.uint8])
def test_a_seed_may_be_a_number_of_numpy(kind):
    env = BaseMotionVectorEnv(2)
    np.testing.assert_array_equal(env.reset(seed=kind(3))[0], env.reset(seed=3)[0])


def test_refuses_actions_of_another_shape():
    env = BaseMotionVectorEnv(2)
    env.reset(seed=0)
    with pytest.raises(KinfeasError, match=r"shape \(2, 3\)"):
        env.step(np.zeros((3, 3)))


def test_refuses_an_empty_batch():
    with pytest.raises(KinfeasError, match="num_envs must be at least 1, not 0"):
        BaseMotionVectorEnv(0)
