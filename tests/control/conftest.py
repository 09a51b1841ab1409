"""Fixtures of the tests of the loop: HSR, whose code path is that of every robot."""

import pytest

from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot


@pytest.fixture(scope="session")
def robot():
    return load_robot("hsr")


@pytest.fixture(scope="session")
def solver(robot):
    return IkSolver(robot)
