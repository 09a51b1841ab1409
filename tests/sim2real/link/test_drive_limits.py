import numpy as np
import pytest

from kinfeas.control.drive import action_size, base_twist
from kinfeas.core import spatial
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from kinfeas.sim2real.link.drive_limits import DriveLimits, arm_go, from_drive, to_drive

DT = 0.02


@pytest.mark.parametrize("name", ["pr2", "tiago"])
def test_what_a_policy_commands_survives_the_way_there_and_back(name):
    base, rng = load_robot(name).base, np.random.default_rng(0)
    for _ in range(50):
        pose = spatial.planar_pose(*rng.uniform(-3.0, 3.0, (3, 1)))
        twist = base_twist(base, pose, rng.uniform(-1.0, 1.0, (1, action_size(base))), DT)[0]
        drive = to_drive(base, pose[0], twist, DT)
        np.testing.assert_allclose(from_drive(base, pose[0], drive, DT), twist, atol=1e-12)
        far = DriveLimits.of(base)
        np.testing.assert_allclose(far.clamp(drive, drive, DT), drive, atol=1e-12)


def test_a_differential_base_is_never_sent_sideways():
    limits = DriveLimits.of(load_robot("tiago").base)
    assert limits.clamp(np.array([0.0, 0.1, 0.0]), np.zeros(3), DT)[1] == 0.0


def test_an_arm_goes_the_short_way_and_not_beyond_its_limits():
    robot = load_robot("pr2")
    before, after = np.zeros((2, len(robot.arm)))
    before[[0, 4]], after[[0, 4]] = [0.5, 3.0], [0.7, -3.0]
    move = joint_displacement(robot, before, after)
    assert move[4] == pytest.approx(2.0 * np.pi - 6.0)
    there = arm_go(robot, before, move)
    assert there[0] == robot.arm[0].upper
    assert there[4] == pytest.approx(-3.0)


def test_an_arm_that_begins_beyond_a_limit_does_not_jump():
    robot = load_robot("pr2")
    before, move = np.zeros((2, len(robot.arm)))
    before[1] = robot.arm[1].upper + 0.05
    assert arm_go(robot, before, move)[1] == before[1]
    move[1] = 0.1
    assert arm_go(robot, before, move)[1] == before[1]
