"""The robot of docs/own_robot.md loads, and IK solves its poses."""

from pathlib import Path

import pytest

from kinfeas.core import spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.topics import read_topics

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "own_robot"


@pytest.fixture(scope="module")
def solver():
    return IkSolver(load_robot(str(FOLDER / "scout.yaml")))


def test_ik_inverts_forward_kinematics(solver):
    spread = spread_configurations(solver.robot, 1000)
    free = spread[~self_collides(solver.collision, spread)]
    assert len(free) > 850
    poses = forward(solver.chain, free)
    solution = solver.solve(poses, free[::-1])
    found = solution.feasible
    assert found.mean() >= 0.995
    reached = forward(solver.chain, solution.joint_positions[found])
    metres, radians = spatial.distance(reached, poses[found])
    assert metres.max() < 1e-4
    assert radians.max() < 1e-3


def test_topics_fit_the_robot(solver):
    topics = read_topics(solver.robot, 2, str(FOLDER / "scout_topics.yaml"))
    assert len(topics.joints.controllers) == 2
