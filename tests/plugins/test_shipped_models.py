import runpy
from pathlib import Path

import numpy as np
import pytest

from kinfeas.plugins.fit import fit
from kinfeas.plugins.imitation import learned_path, read_model
from tests.builders import assert_near

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "simulated_demonstrations.py"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_documented_commands_make_them(name):
    pairs = SCRIPT["demonstrate"](name, 12, seed=0)
    for motion, shown in zip(("grasp", "open"), zip(*pairs, strict=True), strict=True):
        result = fit(shown, "imitation", 8, 0)
        assert not any(result.sides)
        made = result.model
        shipped = read_model(f"{name}_{motion}", "imitation")
        assert made.duration == pytest.approx(shipped.duration)
        index = np.linspace(0.0, 1.0, 50)
        assert_near(learned_path(made).at(index), learned_path(shipped).at(index), 1e-3, 1e-2)
