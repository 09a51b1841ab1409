import json

import pytest

from kinfeas.demonstrations import write_demonstration
from kinfeas.plugins.gaussian_mixture import GaussianMixture
from kinfeas.plugins.imitation import Imitation
from tests.cli.conftest import is_one_line
from tests.plugins.conftest import door_demonstrations


@pytest.fixture
def shown(tmp_path):
    """A folder of demonstrations in either format."""
    folder = tmp_path / "shown"
    folder.mkdir()
    for number, one in enumerate(door_demonstrations(4)):
        write_demonstration(one, folder / f"{number}.{'csv' if number % 2 else 'npz'}")
    return str(folder)


def test_learns_a_motion_that_the_generator_follows(kinfeas, shown, tmp_path):
    arguments = ("--demonstrations", shown, "--out", "door.yaml", "--json", "door.json")
    outcome = kinfeas("fit", *arguments)
    assert outcome.code == 0, outcome.err
    for words in ("imitation model in door.yaml", "demonstrations", "components", "mm", "degrees"):
        assert words in outcome.out
    figures = json.loads((tmp_path / "door.json").read_text())
    assert figures["kind"] == "imitation"
    assert (figures["demonstrations"], figures["components"], figures["base"]) == (4, 8, True)
    assert len(figures["position_residual_m"]) == len(figures["rotation_residual_rad"]) == 4
    assert max(figures["position_residual_m"]) < 0.04
    assert 2.0 < figures["duration_s"] < 5.0
    Imitation(model="./door.yaml")
    text = (tmp_path / "door.yaml").read_text()
    assert "kinfeas fit --demonstrations shown --kind imitation --components 8 --seed 0" in text
    assert str(tmp_path) not in text


def test_learns_the_other_kind(kinfeas, shown):
    choices = ("--kind", "gaussian_mixture", "--components", "5", "--seed", "3")
    outcome = kinfeas("fit", "--demonstrations", shown, "--out", "door.yaml", *choices)
    assert outcome.code == 0, outcome.err
    GaussianMixture(model="door.yaml")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--demonstrations", "nowhere"], "nowhere: no such folder"),
        (["--demonstrations", "."], "holds no demonstrations"),
        (["--demonstrations", "shown", "--kind", "spline"], "spline"),
        (["--demonstrations", "shown", "--components", "0"], "--components"),
        (["--demonstrations", "shown", "--components", "99"], "components must be a number in"),
        (["--demonstrations", "shown", "--out", "missing/door.yaml"], "cannot be written"),
        ([], "--demonstrations"),
    ],
)
def test_bad_input_is_one_line(arguments, message, kinfeas, shown):
    outcome = kinfeas("fit", "--out", "door.yaml", *arguments)
    assert is_one_line(outcome), outcome.err
    assert message in outcome.err


def test_help_shows_the_format(kinfeas):
    assert "ee_qx" in kinfeas("fit", "--help").out
