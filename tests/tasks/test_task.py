import pytest

from kinfeas.errors import KinfeasError
from kinfeas.tasks.task import Leg, MotionSpec, build_legs


def test_equal_motions_share_a_generator():
    slow = MotionSpec("linear", {"max_velocity": 0.05})
    legs = (Leg(), Leg(slow, "tip", 2.0), Leg(MotionSpec("linear")), Leg(slow))
    built = build_legs(legs)
    assert [(leg.frame, leg.wait) for leg in built] == [(leg.frame, leg.wait) for leg in legs]
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
        build_legs([Leg(motion)])
    with pytest.raises(KinfeasError) as second:
        build_legs([Leg(), Leg(motion)])
    assert str(second.value) == f"'legs.1.motion': {alone.value}"
