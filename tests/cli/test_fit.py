import json
from dataclasses import replace

import numpy as np
import pytest

from kinfeas.io.demonstrations import read_demonstration, write_demonstration
from kinfeas.plugins.fit import MOST_COMPONENTS
from kinfeas.plugins.imitation import GaussianMixture, Imitation
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
        (
            ["--demonstrations", "shown", "--components", "99"],
            f"less than or equal to {MOST_COMPONENTS}",
        ),
        (["--demonstrations", "shown", "--out", "missing/door.yaml"], "cannot be written"),
        (["--demonstrations", "shown", "--out", "door.csv"], "--out: door.csv must end in .yaml"),
        (["--demonstrations", "nowhere", "--out", "door"], "--out: door must end in .yaml"),
        ([], "--demonstrations"),
    ],
)
def test_bad_input_is_one_line(arguments, message, kinfeas, shown):
    outcome = kinfeas("fit", "--out", "door.yaml", *arguments)
    assert is_one_line(outcome), outcome.err
    assert message in outcome.err


@pytest.mark.parametrize(
    ("bare", "words"),
    [
        ((2,), "not learned, for it is not shown in 2.npz"),
        ((1, 2, 3), "not shown in 1.csv and 2 more"),
        ((0, 1, 2, 3), "base not shown"),
    ],
)
def test_files_without_a_base_are_named(kinfeas, tmp_path, shown, bare, words):
    for number in bare:
        path = next((tmp_path / "shown").glob(f"{number}.*"))
        write_demonstration(replace(read_demonstration(path), base_pose=None), path)
    outcome = kinfeas("fit", "--demonstrations", shown, "--out", "door.yaml")
    assert outcome.code == 0, outcome.err
    assert words in " ".join(outcome.out.replace("│", " ").split())


def test_help_shows_the_format_and_the_largest_size(kinfeas):
    told = kinfeas("fit", "--help").out
    assert "ee_qx" in told
    assert f"x<={MOST_COMPONENTS}" in told


def test_an_error_names_the_file(kinfeas, shown, tmp_path):
    (tmp_path / "shown" / "notes.txt").touch()
    still = tmp_path / "shown" / "1.csv"
    write_demonstration(_still(door_demonstrations(1)[0]), still)
    outcome = kinfeas("fit", "--demonstrations", "shown", "--out", "door.yaml")
    assert is_one_line(outcome)
    assert outcome.err == "error: shown/1.csv: the EE does not move\n"


def _still(one):
    return replace(one, **{name: np.tile(getattr(one, name)[:1], (len(one.time), 1))
                           for name in ("ee_pose", "base_pose", "object_pose")})  # fmt: skip


def test_brackets_in_a_name_are_shown(kinfeas, shown):
    outcome = kinfeas("fit", "--demonstrations", shown, "--out", "m[bold].yaml")
    assert outcome.code == 0, outcome.err
    assert "model in m[bold].yaml" in " ".join(outcome.out.split())
