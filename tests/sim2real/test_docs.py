"""The adapter of docs/sim2real.md works."""

import re
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.backend import Resumable

PAGE = (Path(__file__).parents[2] / "docs" / "sim2real.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_example_works(rig):
    space: dict[str, object] = {}
    exec(blocks("python")[0], space)
    slippery = rig(space["SlipperyFloor"], n=40, slip=[0.1, 0.3], wander=0.0)
    slippery.run(np.ones((3, 6)))
    np.testing.assert_array_equal(slippery.passed[0], slippery.passed[-1])
    assert 0.7 <= slippery.passed.min() < 0.75
    assert 0.85 < slippery.passed.max() <= 0.9
    assert isinstance(slippery.adapter, Resumable)
    with pytest.raises(ValueError, match="slip"):
        rig(space["SlipperyFloor"], slip=-1)
