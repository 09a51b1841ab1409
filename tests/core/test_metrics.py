from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from kinfeas.core.metrics import EpisodeRecords, summarize, wilson


@pytest.mark.parametrize("trials", [1, 2, 10, 50, 500])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.5, 0.9, 1.0])
def test_wilson_is_scipys(share, trials):
    hits = round(share * trials)
    found = wilson(hits, trials)
    expected = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    assert found.value == hits / trials
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def records():
    """Four episodes: perfect; one failure; large deviation but reached; never arrived."""
    return EpisodeRecords(
        reached=np.array([True, True, True, False]),
        failures=np.array([0, 1, 0, 20]),
        max_deviation=np.array([0.0, 0.05, 0.06, 0.0]),
        mean_deviation=np.array([0.0, 0.01, 0.02, 0.25]),
        final_distance=np.array([0.02, 0.02, 0.02, 0.4]),
        joint_jumps=np.array([0, 1, 0, 5]),
        steps=np.array([400, 500, 600, 100]),
    )


def test_success_and_within():
    np.testing.assert_array_equal(records().success, [True, False, True, False])
    np.testing.assert_array_equal(records().within, [True, True, False, False])


def test_summary_of_a_hand_example():
    low, high = 0.15003898915214947, 0.8499610108478506  # 2 of 4, by scipy
    found = {key: value for key, value in summarize(records()).items() if value is not None}
    assert found == pytest.approx(
        {
            "episodes": 4,
            "success": 0.5,
            "success_low": low,
            "success_high": high,
            "reached": 0.75,
            "within_5cm": 0.5,
            "within_5cm_low": low,
            "within_5cm_high": high,
            "ik_failures_per_episode": 5.25,
            "mean_deviation_m": 0.07,
            "joint_jumps_per_episode": 1.5,
            "mean_steps": 400.0,
        }
    )


def test_task_success_and_collisions_of_backends_that_tell():
    base, arm = np.array([0, 2, 0, 0]), np.array([0, 1, 3, 0])
    done = np.array([True, False, False, False])
    ways = {"path_length": np.full(4, 0.9), "target_path_length": np.ones(4), "rms_deviation": np.full(4, 0.01)}
    told = replace(records(), task_done=done, base_collisions=base, arm_collisions=arm, **ways)
    found = summarize(told)
    assert (found["task_success"], found["collision_free_rate"]) == (0.25, 0.5)
    assert (found["base_collisions"], found["arm_collisions"]) == (0.5, 1.0)
    assert (found["smooth"], found["speed_share"]) == (0.5, pytest.approx(0.9))
    assert found["rms_deviation_m"] == pytest.approx(0.01)
    assert all(type(value) in (int, float) for value in found.values())
    assert summarize(records())["task_success"] is None
