import json

import pytest

from kinfeas.robots.loading import load_robot
from tests.sim2real.policy_cases import write_run


@pytest.fixture
def file(kinfeas, tmp_path):
    """The export of a training run of the HSR, `run`."""
    write_run(load_robot("hsr"), tmp_path / "run" / "checkpoints" / "best")
    kinfeas("export", "run", "--robot", "hsr", "--out", "hsr.onnx", "--json", "out.json", code=0)
    return tmp_path / "hsr.onnx"


def test_export_and_check_show_the_same_metadata(kinfeas, file, tmp_path):
    exported = json.loads((tmp_path / "out.json").read_text())
    assert (tmp_path / "hsr.md").read_text().startswith("---")
    assert 0.0 <= exported.pop("parity") <= 1e-5
    assert exported["robot"]["name"] == "hsr"
    outcome = kinfeas(
        "export", "--check", "hsr.onnx", "--robot", "hsr", "--json", "check.json", code=0
    )
    assert json.loads((tmp_path / "check.json").read_text()) == exported
    for words in ("name: hsr", "arm_lift_joint", "not compared"):
        assert (words in outcome.out) is (words != "not compared")
    assert "not compared" in kinfeas("export", "--check", "hsr.onnx").out
