import runpy
import sys
from pathlib import Path

import pytest

from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.topics import read_topics
from tests.builders import assert_near

EXAMPLES = Path(__file__).parents[1] / "examples"
PRINTED = {
    "deploy_in_process": ["--seconds", "2", "lines recorded"],
    "gymnasium_loop": ["--steps", "40", "40 steps, reward"],
    "ik_only": ["--poses", "100", "--goals", "2", "poses have a solution"],
    "own_generator": ["--episodes", "2", "2 episodes, success"],
    "own_task": ["--episodes", "1", "--robots", "pr2", "pr2: success"],
    "sb3_policy": ["--steps", "128", "--episodes", "2", "--out", "shown", "kinfeas deploy shown"],
    "simulated_demonstrations": ["door", "--count", "1", "--out", "shown", "1 demonstrations"],
    "train_and_evaluate": ["--steps", "128", "--episodes", "1", "the run holds checkpoints"],
}
TESTED_ELSEWHERE = {
    "onnx_inference": "policies/test_onnx_policy.py",
    "target_source": "cli/test_commands.py",
    "udp_backend": "sim2real/link/test_backend.py",
}


def test_every_example_is_run():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    assert names == PRINTED.keys() | TESTED_ELSEWHERE.keys()
    for name, test in TESTED_ELSEWHERE.items():
        assert f"{name}.py" in (Path(__file__).parent / test).read_text()


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_runs(name, monkeypatch, tmp_path, capsys, unregistered):
    *arguments, printed = PRINTED[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert printed in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} <= {"shown"}


def test_the_robot_of_the_examples_has_ik_and_topics():
    folder = EXAMPLES / "own_robot"
    robot = load_robot(folder)
    solver, spread = IkSolver(robot), spread_configurations(robot, 1000)
    free = spread[~self_collides(solver.collision, spread)]
    assert len(free) > 850
    poses = forward(solver.chain, free)
    solution = solver.solve(poses, free[::-1])
    assert solution.feasible.mean() >= 0.995
    reached = forward(solver.chain, solution.joint_positions[solution.feasible])
    assert_near(reached, poses[solution.feasible], 1e-4, 1e-3)
    assert len(read_topics(robot, 2).joints.controllers) == 2
