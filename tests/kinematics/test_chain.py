from dataclasses import replace

import numpy as np
import pytest

from kinfeas.kinematics.forward import FIXED, build_chain, build_tree, forward


def test_chain_holds_the_arm_alone(robot):
    tree = build_chain(robot).tree
    count = len(robot.arm)
    np.testing.assert_array_equal(tree.variable, range(count))
    np.testing.assert_array_equal(tree.parent, range(-1, count - 1))
    np.testing.assert_array_equal(tree.multiplier, 1.0)
    np.testing.assert_array_equal(tree.bias, 0.0)
    kinds = [robot.urdf.joints[joint.name].kind for joint in robot.arm]
    np.testing.assert_array_equal(tree.prismatic, [kind == "prismatic" for kind in kinds])


def test_followers_are_joints_of_the_chain(odd_robot):
    tree = build_chain(odd_robot).tree
    moving = [joint.name for joint in odd_robot.urdf.path_to("hand") if joint.moves]
    names = [joint.name for joint in odd_robot.arm]
    driven = [name for name in moving if name != "neck"]
    followers = {"pull": (0.03, 0.02), "knuckle": (-0.7, 0.1)}
    assert len(tree.variable) == len(names) + len(followers)
    for i, name in enumerate(driven):
        variable, multiplier, bias = tree.variable[i], tree.multiplier[i], tree.bias[i]
        assert names[variable] == ("elbow" if name in followers else name)
        assert (multiplier, bias) == pytest.approx(followers.get(name, (1.0, 0.0)))


def test_a_follower_of_a_follower_adds_up(odd_robot):
    tree, mounts = build_tree(odd_robot)
    finger = mounts["finger"].joint
    assert tree.multiplier[finger] == pytest.approx(2.0 * -0.7)
    assert tree.bias[finger] == pytest.approx(2.0 * 0.1 - 0.1)


def test_parents_come_first(robot):
    tree, mounts = build_tree(robot)
    assert np.all(tree.parent < np.arange(len(tree.parent)))
    assert set(mounts) == set(robot.urdf.links)
    assert mounts[robot.urdf.root].joint == FIXED


def test_constants_are_rotations(robot, odd_robot):
    for each in (robot, odd_robot):
        tree, mounts = build_tree(each)
        turns = np.concatenate([tree.rotation, [mount.rotation for mount in mounts.values()]])
        np.testing.assert_allclose(
            turns @ turns.swapaxes(1, 2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-14
        )
        np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-14)


def test_one_memory_layout_for_all_robots(robot, odd_robot):
    # Kernels are compiled once for each layout of their arguments.
    for each in (robot, odd_robot):
        chain = build_chain(each)
        for array in (*chain.tree, chain.ee_rotation, chain.ee_offset):
            assert array.flags.c_contiguous


def test_joints_outside_the_arm_stand_where_the_robot_says(odd_robot):
    moved = replace(odd_robot, fixed_joints={"neck": -0.3})
    home = odd_robot.home["home"]
    here, there = (forward(build_chain(each), home) for each in (odd_robot, moved))
    assert np.abs(here - there).max() > 0.01
