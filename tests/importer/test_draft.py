import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.draft import DraftOptions, bands, draft_robot
from kinfeas.importer.reach import Heights
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import read_robot
from tests.importer.conftest import STUCK


def written(draft, folder):
    name = draft.spec.name
    (folder / f"{name}.urdf").write_text(draft.urdf)
    path = folder / f"{name}.yaml"
    path.write_text(draft.yaml)
    return path


@pytest.fixture
def few(monkeypatch):
    """Fewer goals, so that it is quick."""
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4, 16))


def test_a_draft_is_a_robot(dolly, tmp_path, few):
    told = []
    draft = draft_robot(dolly, DraftOptions(name="my dolly", drive="omnidirectional"), told.append)
    assert sum(told) == pytest.approx(1.0)
    robot = read_robot(written(draft, tmp_path))
    assert (robot.name, robot.ee_frame, robot.base.drive) == ("my dolly", "palm", "omnidirectional")
    assert [joint.name for joint in robot.arm] == ["pan", "lift", "elbow"]
    assert robot.pose_tolerance is not None
    assert robot.gripper.fingers == ("l", "r")
    assert robot.fixed_joints["l"] == 0.02
    np.testing.assert_array_equal(robot.home["home"], draft.spec.home["home"])
    solver, home = IkSolver(robot), robot.home["home"][np.newaxis]
    assert solver.solve(forward(solver.chain, home), home).feasible.all()


def test_what_is_guessed_is_called_so(dolly, few):
    draft = draft_robot(dolly, DraftOptions())
    assert draft.guesses.speeds == ("pan",)
    assert draft.guesses.limits == ("elbow",)
    assert "  pan: {velocity: 1}  # rad/s, guess\n" in draft.yaml
    assert "  elbow: {soft_limits: [-3.1416, 3.1416]}  # rad, guess\n" in draft.yaml
    assert "  lift: {}\n" in draft.yaml
    assert "where the fingers end\n" in draft.yaml


def test_equal_urdfs_make_equal_drafts(dolly, few):
    once, again = (draft_robot(dolly, DraftOptions()) for _ in range(2))
    assert (once.yaml, once.urdf) == (again.yaml, again.urdf)


def test_a_joint_without_room_is_no_joint_of_the_arm(changed, tmp_path, few):
    """Many URDFs lock a joint so, or forget its limits."""
    draft = draft_robot(changed(*STUCK), DraftOptions())
    robot = read_robot(written(draft, tmp_path))
    assert [joint.name for joint in robot.arm] == ["pan", "lift", "elbow"]
    assert robot.fixed_joints["mount"] == 0.1234567
    assert "  mount: 0.1234567  # rad, its limits leave it no room\n" in draft.yaml


def test_errors_name_the_file_that_was_given(changed):
    path = changed(('<box size="0.04 0.1 0.04"/>', '<box size="0.04 0.1 9999999"/>'))
    with pytest.raises(KinfeasError, match=f"^{path}: "):
        draft_robot(path, DraftOptions())


def test_names_that_yaml_takes_for_something_else_are_quoted(changed, tmp_path, few):
    draft = draft_robot(changed(('"lift"', '"on"'), ('"pan"', '"a: b"')), DraftOptions())
    robot = read_robot(written(draft, tmp_path))
    assert [joint.name for joint in robot.arm] == ["a: b", "on", "elbow"]


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        ([0.1, 0.9, 1.0, 1.0, 0.9, 0.1], ((1.0, 4.0), (2.0, 3.0))),
        ([0.1, 0.5, 0.5, 0.5, 0.5, 0.1], ((1.0, 4.0), (1.75, 3.25))),
    ],
)
def test_heights_are_those_that_are_worth_learning(share, expected):
    assert bands(Heights(np.arange(6.0), np.array(share)), "arm") == expected


@pytest.mark.parametrize("best", [0.1, 0.9])
def test_an_arm_that_reaches_no_range_of_heights_is_one_sentence(best):
    heights = Heights(np.arange(3.0), np.array([0.0, best, 0.0]))
    message = f"arm: the arm reaches 20% of the goals at no range of heights: at best {best:.0%}"
    with pytest.raises(KinfeasError, match=f"{message}, 1 m above"):
        bands(heights, "arm")


def test_joints_of_a_turn_either_way_keep_their_limits(changed, few):
    full = ('lower="-1e16" upper="1e16"', 'lower="-6.28318530718" upper="6.28318530718"')
    assert not draft_robot(changed(full), DraftOptions()).guesses.limits
