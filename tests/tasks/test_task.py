import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.tasks.task import MotionSpec, Subgoal, build_subgoals


def test_equal_motions_share_a_generator():
    slow = MotionSpec("linear", {"max_velocity": 0.05})
    subgoals = (Subgoal(), Subgoal(slow, "tip", 2.0), Subgoal(MotionSpec("linear")), Subgoal(slow))
    built = build_subgoals(subgoals)
    assert [(subgoal.frame, subgoal.dwell) for subgoal in built] == [
        (subgoal.frame, subgoal.dwell) for subgoal in subgoals
    ]
    assert built[0].generator is built[2].generator
    assert built[1].generator is built[3].generator
    assert built[0].generator is not built[1].generator


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (MotionSpec("liner"), "unknown motion generator 'liner'"),
        (MotionSpec("linear", {"gian": 1.0}), "unknown parameter 'gian'"),
    ],
)
def test_wrong_motions_are_one_sentence(motion, message):
    with pytest.raises(KinfeasError, match=message) as alone:
        build_subgoals([Subgoal(motion)])
    with pytest.raises(KinfeasError) as second:
        build_subgoals([Subgoal(), Subgoal(motion)])
    assert str(second.value) == f"'subgoals.1.motion': {alone.value}"


@pytest.mark.parametrize(
    ("count", "key"), [(1, "task.motion.parameters.file"), (2, "task.subgoals.0.motion.parameters")]
)
def test_a_missing_parameter_is_asked_for_by_its_setting(count, key):
    with pytest.raises(KinfeasError, match=f"'file' is missing.*--set {key}"):
        build_subgoals([Subgoal(MotionSpec("replay"))] * count)
