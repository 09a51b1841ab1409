import numpy as np

from kinfeas.robots.robot import joint_displacement, joint_jumps

DT = 0.1


def test_jumps_are_moves_beyond_the_velocity_limit(robot):
    velocity = robot.max_joint_velocity
    before = np.tile(robot.home["home"], (3, 1))
    after = before.copy()
    after[1] += velocity * DT  # at the limit
    after[2, 2] += 1.01 * velocity[2] * DT
    np.testing.assert_array_equal(joint_jumps(robot, before, after, DT), [False, False, True])
    assert not joint_jumps(robot, before, after, 2.0 * DT).any()


def test_continuous_joints_go_the_short_way(robot):
    endless, before = robot.continuous, np.array(robot.home["home"])
    after = before + 0.001
    before[endless], after[endless] = np.pi - 0.001, -np.pi + 0.001
    np.testing.assert_allclose(
        joint_displacement(robot, before, after), np.where(endless, 0.002, 0.001)
    )
    assert not joint_jumps(robot, before, after, DT)
