import pytest

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.backend import PyBulletBackend


@pytest.fixture(scope="session")
def engine():
    """The class of the backend."""
    return PyBulletBackend
