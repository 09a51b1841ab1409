from dataclasses import replace

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.importer.draft import draft_robot, pose_tolerance, reach_of, spec_from_urdf
from kinfeas.importer.reach import Heights
from kinfeas.importer.text import warnings
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.gravity import build_gravity_model, overloaded
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.robots.spec import Reach
from kinfeas.robots.urdf_file import parse_urdf
from tests.importer.conftest import STUCK

LIMITS = 'lower="-2" upper="2"'
WIDE = '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
TOUCHING = ('<link name="lower"/>', f'<link name="lower">{WIDE}</link>')


def test_a_draft_is_a_robot(changed, tmp_path, few):
    names = ('"lift"', '"on"'), ('"pan"', '"a: b"')  # YAML needs quotes around these
    path, shares = changed(*STUCK, *names, TOUCHING), []
    given = {"name": "my dolly", "drive": "omnidirectional"}
    draft = draft_robot(path, **given, on_done=shares.append)
    assert sum(shares) == pytest.approx(1.0)
    (tmp_path / "robot.urdf").write_text(draft.urdf)
    (tmp_path / "robot.yaml").write_text(draft.yaml)
    robot = load_robot(tmp_path)
    assert (robot.name, robot.ee_frame, robot.base.drive) == ("my dolly", "palm", "omnidirectional")
    assert [joint.name for joint in robot.arm] == ["a: b", "on", "elbow"]
    assert robot.pose_tolerance is not None
    assert robot.gripper.fingers == ("l", "r")
    assert (robot.fixed_joints["l"], robot.fixed_joints["mount"]) == (0.02, 0.1234567)
    assert robot.ignored_collisions == {frozenset(pair) for pair in draft.guesses.touching} != set()
    np.testing.assert_array_equal(robot.home["home"], draft.spec.home["home"])
    solver, home = IkSolver(robot), robot.home["home"][np.newaxis]
    assert solver.solve(forward(solver.chain, home), home).feasible.all()
    again = draft_robot(path, **given)
    assert (again.yaml, again.urdf) == (draft.yaml, draft.urdf)


@pytest.mark.parametrize(("fraction", "expected"), [
    ([0.1, 0.9, 1.0, 1.0, 0.9, 0.1], (1.0, 4.0)),
    ([1.0, 1.0, 0.0, 0.9, 0.9, 0.9], (3.0, 5.0)),  # the longest range
    ([0.1, 0.3, 0.5, 0.5, 0.0, 0.0], (2.0, 3.0)),
    ([0.0, 0.9, 0.0, 0.0, 0.0, 0.0], None),
])  # fmt: skip
def test_the_reach_has_heights_with_many_reachable_goals(fraction, expected):
    heights = Heights(np.arange(6.0), np.array(fraction))
    if expected is None:
        with pytest.raises(KinfeasError, match=r"^arm: .*90%.*1 m"):
            reach_of(heights, "arm")
    else:
        assert reach_of(heights, "arm") == Reach(*expected)


@pytest.mark.parametrize(("limits", "turn"), [
    ((-1e16, 1e16), (-3.1416, 3.1416)),
    ((-1.0, 20.0), (-1.0, 5.2832)),
    ((-6.3, 6.27), None),
])  # fmt: skip
def test_joints_of_more_than_two_turns_get_one(changed, limits, turn):
    lower, upper = limits
    path = changed((LIMITS, f'lower="{lower}" upper="{upper}"'))
    urdf = parse_urdf(path)
    arm = find_arm(urdf, None, "dolly")
    spec = spec_from_urdf("dolly", urdf, arm, read_hand(urdf, arm), "differential")
    found = spec.arm["lift"].soft_limits
    assert found == (turn and pytest.approx(turn, abs=1e-9))
    assert turn is None or lower <= found[0] < found[1] <= upper


def test_joints_of_arm_and_fingers_without_a_velocity_limit_get_one(changed, few):
    draft = draft_robot(changed(('velocity="0.1"', 'velocity="0"'), ('velocity="2"', "")), "dolly")
    assert draft.guesses.speeds == ("pan", "elbow", "l", "r")
    assert draft.robot.arm[2].velocity == 1.0
    assert [draft.robot.finger_velocity(finger) for finger in "lr"] == [0.1, 0.1]
    assert "velocity: 0.1  # m/s, guess" in draft.yaml


@pytest.mark.parametrize("other", ["0", "1e9"])
def test_the_guess_for_a_finger_leaves_the_limit_of_the_other(changed, few, other):
    left, right = ('velocity="0.1" effort="30"', 'velocity="0.1" effort="20"')
    path = changed((left, 'velocity="0.5"'), (right, f'velocity="{other}"'))
    draft = draft_robot(path, "dolly", meshes=False)
    assert [draft.robot.finger_velocity(finger) for finger in "lr"] == [0.5, 0.1]


@pytest.mark.parametrize(("effort", "load"), [(20.0, True), (500.0, False), (0.01, False)])
def test_drafts_leave_out_postures_that_motors_cannot_hold(changed, few, effort, load):
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    palm = f'<link name="palm"><inertial><mass value="5"/>{inertia}</inertial>'
    weak = 'velocity="1.5"', f'velocity="1.5" effort="{effort}"'
    draft = draft_robot(changed(('<link name="palm">', palm), weak), "dolly")
    gravity = build_gravity_model(replace(draft.robot, max_gravity_load=1.0))
    assert (draft.spec.max_gravity_load is not None) == load
    assert set(draft.guesses.overloads) == ({"lift"} if effort < 100.0 else set())
    at_home = overloaded(gravity, draft.robot.home["home"])
    names = [joint.name for joint in draft.robot.arm]
    assert draft.guesses.overloaded_at_home == tuple(np.array(names)[at_home])
    assert not (load and at_home.any())
    text = " ".join(warnings(draft.spec, draft.guesses, free=1.0))
    assert ("lift" in text) == (effort < 100.0)


def test_the_pose_tolerance_is_that_of_the_arm():
    hsr, lekiwi = (pose_tolerance(load_robot(name)) for name in ("hsr", "lekiwi"))
    assert hsr.position == pytest.approx(0.1, abs=0.005)
    assert lekiwi.position < 0.04
    assert pose_tolerance(load_robot("pr2")) is None
