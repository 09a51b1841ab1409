import pytest

from kinfeas.config.recipes import load_section, recipes
from kinfeas.core import registry
from kinfeas.core.backend import build_backend
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.deploy.config import DeployConfig


def test_the_default_file_says_what_the_defaults_are():
    assert load_section(DeployConfig, "deploy", "any") == DeployConfig()


@pytest.mark.parametrize("name", recipes("deploy"))
def test_every_shipped_file_is_allowed(name):
    load_section(DeployConfig, "deploy", name.split("/")[-1])


def test_a_backend_is_given_what_it_asks_for(monkeypatch):
    def backend(robot, wheels=2):
        return robot, wheels

    monkeypatch.setattr(registry, "load", lambda *_: backend)
    monkeypatch.setattr(registry, "build", lambda _, __, given: backend(**given))
    assert build_backend("mine", {"wheels": 4}, robot="pr2", scene="room") == ("pr2", 4)


def test_what_follows_from_the_run_is_not_to_be_set():
    with pytest.raises(KinfeasError, match="'pybullet': the parameter 'robot' follows from the"):
        build_backend("pybullet", {"robot": "hsr"}, robot="pr2")


def test_the_analytic_world_asks_for_nothing():
    build_backend("analytic", {}, robot="pr2", scene=None).close()
    with pytest.raises(KinfeasError, match="unknown parameter 'gravity'"):
        build_backend("analytic", {"gravity": 1})
