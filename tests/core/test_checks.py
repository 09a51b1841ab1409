from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.backend import RobotState
from kinfeas.core.checks import CheckedMotion, ConformanceError, check_array, check_state
from kinfeas.core.errors import KinfeasError, plugin_note, raised_by
from kinfeas.core.spatial import IDENTITY

POSES, ZERO, DT = np.tile(IDENTITY, (3, 1)), np.zeros((3, 6)), np.full(3, 0.1)
STATE, NAN = {"goal": POSES, "x": np.zeros(3)}, ZERO * np.nan
SOUND, WXYZ = RobotState(POSES, np.zeros((3, 5))), [0, 1, 2, 6, 3, 4, 5]


@pytest.mark.parametrize(
    "value",
    [
        ZERO[:, :5],
        ZERO.tolist(),
        ZERO.astype(object),
        NAN,
        ZERO.astype(np.float16),
    ],
)
def test_other_arrays_raise_errors(value):
    with pytest.raises(KinfeasError, match=r"^mine "):
        check_array(value, (3, 6), "mine")
    check_array(np.ones((3, 6), dtype=int), (3, 6), "mine")
    check_array(NAN, (3, 6), "mine", finite=False)


@pytest.mark.parametrize(("field", "value"), [
    ("base_pose", POSES[:2]), ("base_pose", POSES * 1.1), ("base_pose", POSES[:, WXYZ]),
    ("joint_positions", np.full((3, 5), np.nan)), ("ee_in_base", ZERO),
    ("ee_in_base", POSES * 1.1), ("localised", POSES * 1.1), ("localised", POSES[0]),
    ("base_twist", POSES), ("age", 0.1), ("true_state", replace(SOUND, base_pose=None)),
])  # fmt: skip
def test_errors_of_states_name_the_field(field, value):
    check_state(replace(SOUND, age=np.full(3, np.nan), true_state=SOUND), 3, 5, "mine")
    for state, name in ((replace(SOUND, **{field: value}), field), (None, "RobotState")):
        with pytest.raises(KinfeasError, match=f"^mine.*{name}"):
            check_state(state, 3, 5, "mine")


@pytest.mark.parametrize("error", [StopIteration(), SystemExit(0)])
def test_exceptions_keep_their_type_and_name_the_plugin(error):
    assert raised_by(error) is None
    with pytest.raises(type(error)) as caught, plugin_note("adapter Mine"):
        raise error
    assert caught.value is error
    assert raised_by(error) == "adapter Mine"


CALLS = {
    "start": (POSES, POSES, [np.random.default_rng(i) for i in range(3)]),
    "goal_pose": (STATE, POSES),
    "base_pose": (STATE, POSES),
    "twist": (STATE, POSES, POSES, DT),
    "ahead": (STATE, POSES, POSES, np.ones(2)),
}


class Motion:
    """Returns a fixed value from each method, by its name."""

    def __init__(self, **values):
        self.values = {"start": STATE, "goal_pose": POSES, "base_pose": POSES}
        self.values |= {"twist": (ZERO, STATE), "ahead": np.stack([POSES, POSES], axis=1), **values}
        for name in CALLS:
            setattr(self, name, lambda *_, name=name: self.values[name])


def call(motion):
    for name, arguments in CALLS.items():
        getattr(motion, name)(*arguments)


@pytest.mark.parametrize(("method", "value"), [
    ("start", [1]), ("start", {"goal": POSES[:1]}), ("start", {"goal": np.array(["a"] * 3)}),
    ("goal_pose", ZERO), ("goal_pose", POSES * 2.0), ("goal_pose", POSES * np.nan),
    ("twist", ZERO), ("twist", (ZERO[:, :3], STATE)), ("twist", (NAN, STATE)),
    ("twist", (ZERO, None)), ("base_pose", POSES[:2]),
    ("base_pose", np.full((3, 7), np.inf)), ("ahead", POSES),
])  # fmt: skip
def test_invalid_values_name_generator_and_method(method, value):
    call(CheckedMotion(Motion(), "mine"))
    with pytest.raises(ConformanceError, match=f"^motion generator mine .*{method}"):
        call(CheckedMotion(Motion(**{method: value}), "mine"))


def test_attributes_with_the_name_of_an_optional_method_are_errors():
    class Flagged(Motion):
        finished = False

    with pytest.raises(ConformanceError, match="'finished'"):
        CheckedMotion(Flagged(), "mine")
