"""The page on adapters says what is."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from kinfeas.config.recipes import recipes
from kinfeas.control.adapters import read_sim2real
from kinfeas.core import registry
from kinfeas.core.backend import Resumable

PAGE = (Path(__file__).parents[2] / "docs" / "sim2real.md").read_text(encoding="utf-8")
NAMES = sorted(plugin.name for plugin in registry.plugins("kinfeas.adapters"))


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_every_recipe_has_a_row():
    for name in recipes("sim2real"):
        assert f"| `{name.removeprefix('sim2real/')}` |" in PAGE


@pytest.mark.parametrize("name", NAMES)
def test_every_adapter_has_a_row_with_its_parameters(name):
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| `{name}` |"))
    parameters = inspect.signature(registry.load("kinfeas.adapters", name)).parameters
    assert all(f"`{name}`" in row for name in parameters if name not in {"backend", "robot"})


def test_the_list_is_one(tmp_path, pr2):
    path = tmp_path / "mine.yaml"
    path.write_text(blocks("yaml")[0])
    assert read_sim2real(str(path)).adapters[0].name == "base_noise"


def test_the_example_works(rig):
    space: dict[str, object] = {}
    exec(blocks("python")[0], space)
    slippery = rig(space["SlipperyFloor"], n=40, slip=[0.1, 0.3], wander=0.0)
    slippery.run(np.ones((3, 6)))
    np.testing.assert_array_equal(slippery.passed[0], slippery.passed[-1])
    assert 0.7 <= slippery.passed.min() < 0.75
    assert 0.85 < slippery.passed.max() <= 0.9
    assert isinstance(slippery.adapter, Resumable)
    with pytest.raises(ValueError, match="slip is -1"):
        rig(space["SlipperyFloor"], slip=-1)
