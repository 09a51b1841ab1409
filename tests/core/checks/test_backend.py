from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.backend import RobotState
from kinfeas.core.checks.backend import BackendAnswers
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY

ARM = 7
SOUND = RobotState(
    IDENTITY[np.newaxis],
    np.zeros((1, ARM)),
    base_twist=np.zeros((1, 6)),
    joint_velocities=np.zeros((1, ARM)),
    age=np.zeros(1),
    ee_in_base=IDENTITY[np.newaxis],
)


class Mine:
    """A backend, for its name."""


@pytest.fixture
def answers():
    return BackendAnswers(Mine(), ARM)


BAD = {
    "nothing": (None, "a RobotState from step, not NoneType"),
    "a list": ({"base_pose": [[0.0] * 7]}, r"a base_pose of shape \(1, 7\) from step, not list"),
    "a flat pose": ({"base_pose": IDENTITY}, r"a base_pose of shape .* from step, not \(7,\)"),
    "words": ({"base_pose": SOUND.base_pose.astype(str)}, "a base_pose of .* not an array of <U32"),
    "complex": ({"joint_positions": np.zeros((1, ARM), complex)}, "joint_positions .* of complex"),
    "a short arm": ({"joint_positions": np.zeros((1, 6))}, r"joint_positions of shape \(1, 7\)"),
    "an old age": ({"age": "old"}, r"an age of shape \(1,\) from step, not str"),
    "a bare age": ({"age": 0.1}, r"an age of shape \(1,\) from step, not float"),
    "no age": ({"age": np.zeros(0)}, r"an age of shape \(1,\) from step, not \(0,\)"),
    "a flat twist": ({"base_twist": np.zeros(6)}, r"a base_twist of shape \(1, 6\) from step, not"),
    "no speeds": ({"joint_velocities": np.zeros((1, 0))}, r"joint_velocities of shape \(1, 7\)"),
    "no EE": ({"ee_in_base": np.zeros(3)}, r"an ee_in_base of shape \(1, 7\) from step, not"),
    "a lie": ({"true_state": "yes"}, "a RobotState as true_state from step, not str"),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_answers_are_refused(answers, name):
    changes, sentence = BAD[name]
    answer = None if changes is None else replace(SOUND, **changes)
    with pytest.raises(KinfeasError, match=f"^backend Mine must return {sentence}"):
        answers.state(answer, "step")


@pytest.mark.parametrize(
    "answer",
    [
        SOUND,
        RobotState(SOUND.base_pose, SOUND.joint_positions),
        RobotState(SOUND.base_pose.astype(np.float32), SOUND.joint_positions.astype(int)),
        replace(SOUND, true_state=SOUND),
        # Whether they can be believed is for the guards to say.
        replace(SOUND, base_pose=np.full((1, 7), np.nan), age=np.array([np.inf])),
    ],
)
def test_sound_answers_come_through(answers, answer):
    assert answers.state(answer, "read") is answer
