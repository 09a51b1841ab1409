"""The package's numbers as they were: deliberate changes renew a figure with `renew.py`.

Where processor and versions are those that wrote a figure, it must be equal to the last bit.
Elsewhere last bits differ, and grow: one step of an episode or of a training turns out otherwise,
and all after it. There IK, observations and actions must be equal to 1e-6, and episodes and
trainings only similar.
"""

import numpy as np
import pytest

from tests.golden.figures import FIGURES
from tests.golden.renew import DATA, machine, read

SLOW = ("rollout_planner", "physics", "training")
CLOSE = 1e-6
OTHER_SOLUTIONS = 0.01
"""Share of IK targets for which another restart may win where the last bits differ."""


def kind(name):
    return name.split("-")[0]


def cases():
    return [
        pytest.param(name, marks=pytest.mark.slow if kind(name) in SLOW else ()) for name in FIGURES
    ]


@pytest.mark.parametrize("name", cases())
def test_a_figure_is_what_it_was(name):
    stored, writer = read(name)
    found = FIGURES[name]()
    assert found.keys() == stored.keys()
    if writer == machine():
        for key, values in stored.items():
            np.testing.assert_array_equal(found[key], values, err_msg=f"{name}: {key}", strict=True)
    else:
        ELSEWHERE[kind(name)](found, stored)


def check_ik(found, stored):
    np.testing.assert_allclose(found["targets"], stored["targets"], atol=CLOSE)
    for start in ("cold", "warm"):
        keys = [key for key in stored if key.startswith(start)]
        off = [np.abs(1.0 * found[key] - stored[key]).reshape(len(stored[key]), -1) for key in keys]
        other = (np.concatenate(off, axis=1) > CLOSE).any(axis=1)
        assert other.mean() <= OTHER_SOLUTIONS, f"{start}: other solutions to {other.sum()} targets"


def check_close(found, stored):
    for key, values in stored.items():
        np.testing.assert_allclose(found[key], values, rtol=0.0, atol=CLOSE, err_msg=key)


def check_episodes(found, stored):
    episodes = len(stored["success"])
    for key in ("success", "reached", "task_done"):
        if key in stored:
            assert abs(int(found[key].sum()) - int(stored[key].sum())) <= max(1, episodes // 5), key
    if episodes >= 20:
        assert found["steps"].mean() == pytest.approx(stored["steps"].mean(), rel=0.25)


def check_training(found, stored):
    for key in ("first_layer", "layer_sums"):
        assert np.isfinite(found[key]).all()
    assert found["steps"] == stored["steps"]
    assert abs(found["best_success"] - stored["best_success"]) <= 0.5


ELSEWHERE = {
    "ik": check_ik,
    "policy": check_close,
    "obstacle_filter": check_close,
    "training": check_training,
    **dict.fromkeys(("plain", "feasibility_filter", "rollout_planner", "physics"), check_episodes),
}


def test_each_figure_is_stored_and_each_file_is_a_figure():
    assert {path.stem for path in DATA.iterdir()} == set(FIGURES)
