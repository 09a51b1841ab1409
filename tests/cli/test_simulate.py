import pytest

from tests.cli.conftest import is_one_line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("--backend", "analytic"),
            "analytic",
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


def test_a_robot_that_would_begin_in_furniture_is_one_line(kinfeas, tmp_path):
    pytest.importorskip("pybullet")
    tables = "objects: {desk: {urdf: table.urdf}}"
    (tmp_path / "origin.yaml").write_text(f"name: office\nsize: [4, 4]\n{tables}\n")
    outcome = kinfeas("simulate", "--robot", "hsr", "--scene", "origin.yaml")
    assert is_one_line(outcome), outcome
    assert "scene office: robot 'hsr' begins at the origin and would touch 'desk'" in outcome.err
