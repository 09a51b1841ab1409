import json

import pytest

from kinfeas.io.demonstrations import write_demonstration
from kinfeas.plugins.imitation import GaussianMixture, Imitation
from tests.plugins.conftest import door_demonstrations


@pytest.fixture
def shown(tmp_path):
    """A folder of demonstrations in both formats."""
    (tmp_path / "shown").mkdir()
    for number, one in enumerate(door_demonstrations(4)):
        write_demonstration(one, tmp_path / "shown" / f"{number}.csv")
    return tmp_path / "shown"


@pytest.mark.parametrize(
    ("generator", "kind", "components"),
    [(Imitation, "imitation", 8), (GaussianMixture, "gaussian_mixture", 5)],
)
def test_generator_follows_the_model(kinfeas, shown, tmp_path, generator, kind, components):
    given = ("--demonstrations", "shown", "--out", "door.yaml", "--json", "door.json")
    kinfeas("fit", *given, "--kind", kind, "--components", str(components), "--seed", "3", code=0)
    generator(model="./door.yaml")
    figures = json.loads((tmp_path / "door.json").read_text())
    assert (figures["demonstrations"], figures["base"]) == (4, True)
    assert figures["components"] == components
    assert max(figures["position_residual_m"]) < 0.04
    text = (tmp_path / "door.yaml").read_text()
    assert "kinfeas fit --demonstrations shown" in text
    assert str(tmp_path) not in text
