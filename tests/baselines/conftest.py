import pytest

from kinfeas.baselines.reach_ellipses import fit_ellipses


@pytest.fixture(scope="session")
def ellipses(robot):
    """The ellipses of each robot, fitted once."""
    return fit_ellipses(robot)
