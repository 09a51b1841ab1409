import pytest

from tests.cli.conftest import is_one_line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("--backend", "analytic"),
            "backend 'analytic' is on no bus that a robot can be played on",
        ),
        (("--task", "door", "--scene", "room"), "--task has a scene of its own: leave --scene out"),
        (("--robot", "pr3"), "unknown robot 'pr3'"),
        (("--topics", "pr3"), "unknown topics 'pr3'"),
        (("--scene", "attic"), "attic"),
        (("--scene", ""), "unknown scene ''"),
        (("--topics", ""), "unknown topics ''"),
    ],
)
def test_bad_input_is_one_line(kinfeas, arguments, said):
    outcome = kinfeas("simulate", *arguments)
    assert is_one_line(outcome), outcome
    assert said in outcome.err
