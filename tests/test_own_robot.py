"""The robot of docs/own_robot.md: its files load, IK is right for it and its world runs."""

import re
from pathlib import Path

import numpy as np

from kinfeas.core import spatial
from kinfeas.envs.interface import make_world
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.loading import load_robot
from kinfeas.robots.spec import RobotSpec
from kinfeas.sim2real.ros.names import read_topics

ROOT = Path(__file__).parents[1]
YAML = str(ROOT / "examples" / "own_robot" / "scout.yaml")
TOPICS = ROOT / "examples" / "own_robot" / "scout_topics.yaml"
PAGE = (ROOT / "docs" / "own_robot.md").read_text()


def test_loads():
    robot = load_robot(YAML)
    assert robot.base.drive == "differential"
    assert len(robot.arm) == 8
    assert robot.gripper is not None


def test_few_configurations_touch_themselves_and_home_does_not():
    solver = IkSolver(load_robot(YAML))
    home = solver.robot.home["home"][np.newaxis]
    assert not self_collides(solver.collision, home).any()
    spread = spread_configurations(solver.robot, 1000)
    assert self_collides(solver.collision, spread).mean() < 0.15


def test_ik_finds_what_forward_kinematics_made():
    solver = IkSolver(load_robot(YAML))
    spread = spread_configurations(solver.robot, 1000)
    free = spread[~self_collides(solver.collision, spread)]
    poses = forward(solver.chain, free)
    solution = solver.solve(poses, free[::-1])
    assert solution.feasible.mean() >= 0.995
    found = solution.feasible
    reached = forward(solver.chain, solution.joint_positions[found])
    metres, radians = spatial.distance(reached, poses[found])
    assert metres.max() < 1e-4
    assert radians.max() < 1e-3


def test_its_world_runs():
    world = make_world(YAML, "ggr")
    world.start(range(8))
    for _ in range(20):
        transition = world.step(np.zeros((8, world.action_size)))
    assert transition.observation.shape == (8, 29)
    assert np.isfinite(transition.reward).all()


def test_the_page_explains_every_key():
    for name in RobotSpec.__dataclass_fields__:
        assert re.search(rf"^\| `{name}` \|", PAGE, re.MULTILINE), name


def test_the_topics_of_the_page_are_those_of_the_file():
    assert f"```yaml\n{TOPICS.read_text()}```" in PAGE
    topics = read_topics(load_robot(YAML), 2, str(TOPICS))
    assert len(topics.joints.controllers) == 2
