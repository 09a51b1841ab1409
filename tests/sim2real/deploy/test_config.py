import pytest

from kinfeas.config.recipes import load_section
from kinfeas.core.backend import build_backend
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.deploy.config import DeployConfig


def test_any_robot_waits_for_its_arm_and_its_grasp():
    config = load_section(DeployConfig, "deploy", "any")
    assert config == DeployConfig(arm_settle_timeout=8.0, grasp_settle_time=5.0)


def test_unknown_parameters_and_those_of_the_run_are_errors():
    build_backend("analytic", {}, robot="pr2", scene=None).close()
    with pytest.raises(KinfeasError, match="gravity"):
        build_backend("analytic", {"gravity": 1})
    with pytest.raises(KinfeasError, match="robot"):
        build_backend("pybullet", {"robot": "hsr"}, robot="pr2")
