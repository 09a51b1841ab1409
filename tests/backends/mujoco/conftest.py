import pytest

pytest.importorskip("mujoco")

from kinfeas.backends.mujoco.backend import MuJoCoBackend


@pytest.fixture(scope="session")
def engine():
    return MuJoCoBackend
