import numpy as np
import pytest
from scipy.stats import kstest

from kinfeas.core import registry
from kinfeas.core.backend import RobotState, Stochastic
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.adapters.base_noise import BaseNoise
from kinfeas.sim2real.adapters.draws import Range

PR2 = load_robot("pr2")


class Recorder:
    """Keeps the twists that get through."""

    def __init__(self):
        self.twists, self.closed = [], 0

    def reset(self, base_pose, joint_positions, env_ids=None):
        self.last_reset = base_pose, joint_positions, env_ids
        return RobotState(base_pose, joint_positions)

    def step(self, base_twist, joint_targets, dt):
        self.twists.append(base_twist.copy())
        self.targets = joint_targets
        return RobotState(np.zeros((len(base_twist), 7)), joint_targets)

    def close(self):
        self.closed += 1


def seeds(*values):
    return np.array(values, dtype=np.uint64)


def draws(given, steps, **deviations):
    """Return the noise of episodes with these seeds, shape (steps, n, 6)."""
    recorder = Recorder()
    noise = BaseNoise(recorder, PR2, **deviations)
    on_reset(noise, given)
    for _ in range(steps):
        noise.step(np.zeros((len(given), 6)), np.zeros((len(given), 1)), 0.1)
    return np.stack(recorder.twists)


def on_reset(noise, given):
    n = len(given)
    noise.seed(given, np.arange(n))
    noise.reset(np.zeros((n, 7)), np.zeros((n, 1)))


def many(steps=2000, n=50):
    given = np.random.default_rng(0).integers(2**64, size=n, dtype=np.uint64)
    return draws(given, steps, linear=1.0, angular=1.0)[..., [0, 1, 5]]


def test_draws_are_standard_normal():
    found = many().reshape(-1, 3)
    for column in found.T:
        assert kstest(column, "norm").pvalue > 1e-3
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=4.0 / np.sqrt(len(found)))
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=4.0 / np.sqrt(2.0 * len(found)))


def test_draws_are_independent():
    found = many()
    scale = 4.0 / np.sqrt(found[1:].size / 3)
    within = np.corrcoef(found.reshape(-1, 3).T)
    np.testing.assert_allclose(within, np.eye(3), atol=scale)
    for axis in range(3):
        values = found[..., axis]
        for lag in (1, 2, 7):
            assert abs(np.mean(values[lag:] * values[:-lag])) < scale
        assert abs(np.mean(values[:, 1:] * values[:, :-1])) < scale
        assert abs(np.mean(np.abs(values[1:]) * np.abs(values[:-1])) - 2.0 / np.pi) < 2.0 * scale


def test_neighbouring_seeds_are_as_independent_as_any():
    found = draws(np.arange(2000, dtype=np.uint64), 20, linear=1.0, angular=1.0)[..., [0, 1, 5]]
    assert kstest(found.ravel(), "norm").pvalue > 1e-3
    assert abs(np.mean(found[:, 1:] * found[:, :-1])) < 4.0 / np.sqrt(found.size)
    assert len(np.unique(found)) == found.size


def test_deviations_scale_the_planar_velocity_and_the_turning():
    plain, scaled = (
        draws(seeds(5), 9, linear=1.0, angular=1.0),
        draws(seeds(5), 9, linear=0.5, angular=0.1),
    )
    np.testing.assert_array_equal(scaled[..., :2], plain[..., :2] * 0.5)
    np.testing.assert_array_equal(scaled[..., 5], plain[..., 5] * 0.1)
    np.testing.assert_array_equal(plain[..., 2:5], 0.0)
    np.testing.assert_array_equal(draws(seeds(5), 9, linear=0.0, angular=0.0), 0.0)


def test_defaults_are_the_methods():
    ranges = BaseNoise(Recorder(), PR2).ranges
    assert ranges == {"linear": Range(0.015, 0.015), "angular": Range(0.015, 0.015)}


def test_is_added_to_the_command_and_leaves_the_rest_alone():
    recorder = Recorder()
    noise = BaseNoise(recorder, PR2)
    on_reset(noise, seeds(5))
    twist, targets = np.arange(6.0)[np.newaxis], np.ones((1, 7))
    noise.step(twist, targets, 0.1)
    np.testing.assert_array_equal(twist, [np.arange(6.0)])
    assert recorder.targets is targets
    expected = draws(seeds(5), 1, linear=0.015, angular=0.015)[0] + twist
    np.testing.assert_array_equal(recorder.twists[0], expected)


def test_a_row_does_not_depend_on_the_batch():
    given = np.random.default_rng(1).integers(2**64, size=67, dtype=np.uint64)
    together = draws(given, 10)
    for i in range(67):
        np.testing.assert_array_equal(draws(given[i : i + 1], 10)[:, 0], together[:, i])


def test_a_new_episode_begins_its_draws_anew():
    recorder = Recorder()
    noise = BaseNoise(recorder, PR2)
    on_reset(noise, seeds(1, 2, 3))
    for _ in range(4):
        noise.step(np.zeros((3, 6)), np.zeros((3, 1)), 0.1)
    noise.seed(seeds(9), np.array([1]))
    noise.reset(np.zeros((3, 7)), np.zeros((3, 1)), np.array([1]))
    for _ in range(4):
        noise.step(np.zeros((3, 6)), np.zeros((3, 1)), 0.1)
    found, expected = np.stack(recorder.twists), draws(seeds(1, 9, 3), 8)
    np.testing.assert_array_equal(found[:, [0, 2]], expected[:, [0, 2]])
    np.testing.assert_array_equal(found[4:, 1], expected[:4, 1])


def test_same_seed_same_draws_and_other_seed_others():
    np.testing.assert_array_equal(draws(seeds(4), 5), draws(seeds(4), 5))
    extremes = draws(seeds(0, 1, 2**63, 2**64 - 1), 5)
    assert np.isfinite(extremes).all()
    assert len(np.unique(extremes[..., 0])) == 20


def test_the_batch_may_grow_and_shrink():
    recorder = Recorder()
    noise = BaseNoise(recorder, PR2)
    for n in (2, 5, 1, 3):
        on_reset(noise, np.arange(n, dtype=np.uint64))
        noise.step(np.zeros((n, 6)), np.zeros((n, 1)), 0.1)
        np.testing.assert_array_equal(
            recorder.twists[-1], draws(np.arange(n, dtype=np.uint64), 1)[0]
        )


def test_wrapped_twice_draws_twice():
    recorder = Recorder()
    noise = BaseNoise(BaseNoise(recorder, PR2, linear=1.0), PR2, linear=1.0)
    given = np.random.default_rng(0).integers(2**64, size=4000, dtype=np.uint64)
    on_reset(noise, given)
    noise.step(np.zeros((4000, 6)), np.zeros((4000, 1)), 0.1)
    assert recorder.twists[0][:, 0].std() == pytest.approx(np.sqrt(2.0), rel=0.05)


def test_passes_on_the_rest():
    recorder = Recorder()
    noise = BaseNoise(recorder, PR2)
    assert isinstance(noise, Stochastic)
    base, joints = np.zeros((2, 7)), np.zeros((2, 6))
    assert noise.reset(base, joints).base_pose is base
    assert recorder.last_reset == (base, joints, None)
    noise.close()
    noise.close()
    assert recorder.closed == 2


@pytest.mark.parametrize("name", ["linear", "angular"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_deviations_are_finite_and_not_negative(name, value):
    with pytest.raises(KinfeasError, match=f"{name} is .*, must be a finite number in"):
        registry.build(
            "kinfeas.adapters",
            "base_noise",
            {"backend": Recorder(), "robot": PR2, name: value},
        )


def test_a_deviation_that_is_no_number_is_one_sentence():
    with pytest.raises(KinfeasError, match="base_noise"):
        registry.build(
            "kinfeas.adapters",
            "base_noise",
            {"backend": Recorder(), "robot": PR2, "linear": "much"},
        )


def test_the_draws_stay_what_they_were():
    expected = [
        [0.02047488446185842, -0.005947859628807266, 6.747789239746878e-05],
        [-0.0035069849951385483, 0.0006755159432595721, 0.010429582057997535],
    ]
    np.testing.assert_array_equal(draws(seeds(7), 2)[:, 0, [0, 1, 5]], expected)
