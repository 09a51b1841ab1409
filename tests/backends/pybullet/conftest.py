import pytest

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.backend import PyBulletBackend


@pytest.fixture(scope="session")
def engine():
    return PyBulletBackend


@pytest.fixture(scope="session")
def world(hsr, scene, engine):
    """That of this engine: one that other folders share may be of another."""
    backend = engine(hsr, scene)
    yield backend
    backend.close()
