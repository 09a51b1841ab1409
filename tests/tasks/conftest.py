"""Samples of tasks on one robot."""

import numpy as np
import pytest

from kinfeas.core.start import stacked
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot


@pytest.fixture(scope="session")
def hsr():
    return IkSolver(load_robot("hsr"))


@pytest.fixture(scope="session")
def sample(hsr):
    """A function that returns n episodes of a task, stacked."""

    def draw(task, n=300):
        episodes = [task.sample(hsr, np.random.default_rng((0, i))) for i in range(n)]
        return stacked(episodes)

    return draw


@pytest.fixture(scope="session")
def uniform():
    from scipy.stats import kstest

    return lambda values, low, high: kstest(values, "uniform", (low, high - low)).pvalue > 1e-4
