"""Fixtures and settings that all tests share."""

import os

# Before anything imports them: one thread a library, and no display.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import settings

from kinfeas import registry
from kinfeas.kinematics.ik import IkOptions, IkSolver

# Numba compiles within the first example, and a busy machine takes long over any.
settings.register_profile("kinfeas", deadline=None, derandomize=True)
settings.load_profile("kinfeas")


@pytest.fixture(scope="session", params=["pr2", "tiago", "hsr"])
def robot(request):
    """Each shipped robot in turn."""
    return registry.load_robot(request.param)


@pytest.fixture(scope="session")
def solver(robot):
    """Its solver as the world uses it."""
    return IkSolver(robot)


@pytest.fixture(scope="session")
def exact_solver(robot):
    """Its solver without leeway."""
    return IkSolver(robot, IkOptions(leeway=False))
