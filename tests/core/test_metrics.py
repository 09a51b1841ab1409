from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from kinfeas.core.metrics import EpisodeRecords, join, summarize, wilson

# Perfect; one failure; large deviation but reached; never arrived.
RECORDS = EpisodeRecords(
    reached=np.array([True, True, True, False]),
    failures=np.array([0, 1, 0, 20]),
    max_deviation=np.array([0.0, 0.05, 0.06, 0.0]),
    mean_deviation=np.array([0.0, 0.01, 0.02, 0.25]),
    final_distance=np.array([0.02, 0.02, 0.02, 0.4]),
    joint_jumps=np.array([0, 1, 0, 5]),
    steps=np.array([400, 500, 600, 100]),
)
MEASURED = replace(
    RECORDS,
    task_done=np.array([True, False, False, False]),
    base_collisions=np.array([0, 2, 0, 0]),
    arm_collisions=np.array([0, 1, 3, 0]),
    path_length=np.full(4, 0.9),
    target_path_length=np.ones(4),
    rms_deviation=np.full(4, 0.01),
    max_tracking_error=np.array([0.0, 0.01, 0.02, 0.2]),
    mean_tracking_error=np.full(4, 0.01),
    response_sums=np.array([[0.1, 1.0], [0.1, 1.0], [0.0, 0.0], [0.2, 2.0]]),
)


@pytest.mark.parametrize("trials", [1, 2, 10, 50, 500])
@pytest.mark.parametrize("rate", [0.0, 0.01, 0.3, 0.5, 0.9, 1.0])
def test_wilson_is_scipys(rate, trials):
    hits = round(rate * trials)
    interval = wilson(hits, trials)
    expected = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    assert interval.value == hits / trials
    assert (interval.low, interval.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_summary():
    assert RECORDS.success.tolist() == [True, False, True, False]
    assert RECORDS.within.tolist() == [True, True, False, False]
    low, high = 0.15003898915214947, 0.8499610108478506  # 2 of 4, by scipy
    always = {
        "episodes": 4,
        **{"success": 0.5, "success_low": low, "success_high": high, "reached": 0.75},
        **{"within_5cm": 0.5, "within_5cm_low": low, "within_5cm_high": high},
        **{"ik_failures_per_episode": 5.25, "mean_deviation_m": 0.07},
        **{"joint_jumps_per_episode": 1.5, "mean_steps": 400.0},
    }
    exact = {"tracked_5cm": 0.5, "tracked_5cm_low": low, "tracked_5cm_high": high}
    exact["mean_tracking_error_m"] = 0.07
    measured = {
        **{"task_success": 0.25, "collision_free_rate": 0.5, "smooth": 0.5, "speed_share": 0.9},
        **{"tracked_5cm": 0.75, "mean_tracking_error_m": 0.01, "lateness_s": 0.1},
        **{"base_collisions": 0.5, "arm_collisions": 1.0, "rms_deviation_m": 0.01},
    }
    summary = summarize(RECORDS)
    assert {k: v for k, v in summary.items() if v is not None} == pytest.approx(always | exact)
    summary = summarize(MEASURED)
    expected = always | measured
    assert {key: summary[key] for key in expected} == pytest.approx(expected)
    assert all(type(value) in (int, float) for value in summary.values())
    resting = summarize(replace(MEASURED, target_path_length=np.zeros(4)))
    assert resting["speed_share"] is None


def test_joined_records_of_runs_with_and_without_solids():
    for parts, collisions in (
        ([RECORDS, MEASURED], [0, 0, 0, 0, 0, 2, 0, 0]),
        ([MEASURED, RECORDS], [0, 2, 0, 0, 0, 0, 0, 0]),
    ):
        joined = join(parts)
        np.testing.assert_array_equal(joined.steps, np.tile(RECORDS.steps, 2))
        np.testing.assert_array_equal(joined.base_collisions, collisions)
        assert joined.base_collisions.dtype == MEASURED.base_collisions.dtype
    whole = join([replace(MEASURED, base_collisions=None)] * 2)
    for key, values in vars(MEASURED).items():
        expected = None if key == "base_collisions" else np.concatenate([values, values])
        np.testing.assert_array_equal(getattr(whole, key), expected, err_msg=key)
