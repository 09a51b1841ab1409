import shutil
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.loading import read_robot
from kinfeas.tasks.arm_start import random_arm


def draws(solver, n=300, accept=None):
    return np.array([random_arm(solver, np.random.default_rng((0, i)), accept) for i in range(n)])


def test_within_limits_free_and_above_the_floor(solver):
    robot, joints = solver.robot, draws(solver)
    lower, upper = robot.joint_limits
    assert np.all((joints >= lower) & (joints <= upper))
    assert not self_collides(solver.collision, joints).any()
    tip = np.concatenate([robot.tool_tip, [0.0, 0.0, 0.0, 1.0]])
    ee = forward(solver.chain, joints)
    assert compose(ee, np.broadcast_to(tip, ee.shape))[:, 2].min() > 0.0


def test_covers_the_limits(solver):
    lower, upper = solver.robot.finite_joint_limits
    share = (draws(solver) - lower) / (upper - lower)
    assert share.min(axis=0).max() < 0.1
    assert share.max(axis=0).min() > 0.9


def test_same_seed_same_arm(solver):
    np.testing.assert_array_equal(draws(solver, 20), draws(solver, 20))
    assert len(np.unique(draws(solver, 20)[:, 0])) == 20


def test_accepts_what_the_caller_does(solver):
    joints = draws(solver, 50, lambda ee: (ee[:, 2] > 0.5) & (ee[:, 2] < 0.6))
    height = forward(solver.chain, joints)[:, 2]
    assert np.all((height > 0.5) & (height < 0.6))


def test_gives_up_in_one_sentence(solver):
    with pytest.raises(KinfeasError, match="no arm configuration free of self-collision"):
        random_arm(solver, np.random.default_rng(0), lambda ee: ee[:, 2] > 9.0)


def test_names_links_that_always_touch(tmp_path):
    folder = Path(__file__).parents[2] / "examples" / "own_robot"
    wide = (folder / "scout.urdf").read_text().replace("0.16 0.26 0.62", "1.8 1.8 2.6")
    (tmp_path / "scout.urdf").write_text(wide)
    shutil.copy(folder / "scout.yaml", tmp_path)
    solver = IkSolver(read_robot(tmp_path / "scout.yaml"), IkOptions(self_collision=False))
    with pytest.raises(KinfeasError, match=r"; the links '\w+' and 'mast_link' touch in \d+%"):
        random_arm(solver, np.random.default_rng(0))
