import json
from pathlib import Path

import pytest

from kinfeas.core.registry import GROUPS
from kinfeas.testing import RULES
from tests.cli.conftest import check_one_line


@pytest.fixture
def info(kinfeas, tmp_path):
    """Return a function that returns the JSON of `kinfeas plugins info NAME`."""

    def run(name):
        outcome = kinfeas("plugins", "info", name, "--json", "info.json")
        assert (outcome.code, outcome.err) == (0, "")
        assert f" {Path(name).stem}, from " in outcome.out
        return json.loads((tmp_path / "info.json").read_text())[0]

    return run


def test_list_has_every_group(kinfeas, tmp_path):
    outcome = kinfeas("plugins", "list", "--json", "plugins.json", code=0)
    found = json.loads((tmp_path / "plugins.json").read_text())
    assert {one["group"] for one in found} == set(GROUPS)
    own = [one for one in found if one["distribution"] == "kinfeas"]
    assert all(one["description"] and one["error"] is None for one in own)
    assert all(f"{kind}s".replace("ys", "ies") in outcome.out for kind in GROUPS.values())


def test_info_on_parameters(info):
    known = info("linear")
    gain = {one["name"]: one for one in known["parameters"]}["gain"]
    assert gain == {"name": "gain", "type": "float", "default": 0.1}
    assert "gain: Speed per distance" in known["text"]
    required = {one["name"]: one for one in info("waypoints")["parameters"]}["file"]
    assert "default" not in required
    assert {one["name"]: one["default"] for one in info("ggr")["parameters"]}["distance"] == [1, 5]


def test_check_reports_every_rule(kinfeas, tmp_path):
    kinfeas("plugins", "check", "linear", "--picture", "a.png", "--json", "a.json", code=0)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["passed"] is True
    assert [one["rule"] for one in found["rules"]] == list(RULES)


def test_check_of_a_policy(kinfeas, tmp_path):
    kinfeas("plugins", "check", "follow_ee", "--robot", "hsr", "--json", "a.json", code=0)
    assert json.loads((tmp_path / "a.json").read_text())["passed"] is True
    check_one_line(kinfeas("plugins", "check", "follow_ee", "--set", "gain=1"), "follow_ee")
    check_one_line(kinfeas("plugins", "check", "follow_ee"), "--robot")


def test_check_of_a_generator_that_breaks_rules(kinfeas, tmp_path):
    settings = ["--set", "max_velocity=0.4", "--set", "max_angular_velocity=null"]
    words = [*settings, "--duration", "9", "--json", "a.json"]
    outcome = kinfeas("plugins", "check", "linear", *words)
    check_one_line(outcome)
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["passed"] is False
    broken = {one["rule"] for one in found["rules"] if one["result"] == "broken"}
    assert {"angular_velocity", "arrival"} <= broken
