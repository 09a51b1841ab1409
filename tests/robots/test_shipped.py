import numpy as np
import pytest

from kinfeas.core import registry
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot

GROUP = "kinfeas.robots"


@pytest.mark.parametrize("name", registry.names(GROUP))
def test_a_shipped_robot_is_a_folder_with_its_licence(name):
    robot = load_robot(name)
    assert registry.build(GROUP, name, {}) == robot.folder
    assert (robot.name, robot.folder.name) == (name, name)
    head = (robot.folder / "robot.yaml").read_text().partition("name: ")[0]
    assert registry.load(GROUP, name).__doc__ == head.splitlines()[0].removeprefix("# ")
    assert "licence" in head
    solver, home = IkSolver(robot), robot.home["home"][np.newaxis]
    assert solver.solve(forward(solver.chain, home), home).feasible.all()
