import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from kinfeas.io.demonstrations import demonstration_files, read_demonstration

EXAMPLE = Path(__file__).parents[2] / "examples" / "target_source.py"


def test_the_ee_follows_a_source_of_the_working_directory(kinfeas, tmp_path):
    pytest.importorskip("mujoco")
    shutil.copy(EXAMPLE, tmp_path / "circles.py")
    relaxed = [f"guards.{name}=5" for name in ("max_age", "max_period", "max_clock_skew")]
    settings = [word for one in relaxed for word in ("--set", one)]
    kinfeas(
        "servo", "--robot", "pr2", "--backend", "mujoco", "--source", "circles:Circle",
        "--seconds", "2", "--record", "run.csv", "--json", "run.json", *settings, code=0,
    )  # fmt: skip
    found = json.loads((tmp_path / "run.json").read_text())
    assert (found["failures"], found["time_scale"]) == (0, 1.0)
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()[1:]]
    column = lines[0].index("desired.y")
    assert lines[1][column] != lines[-1][column]
    kinfeas("dataset", "run.csv", "--out", "shown", "--kind", "csv", code=0)
    (shown,) = map(read_demonstration, demonstration_files(tmp_path / "shown"))
    assert np.ptp(shown.ee_pose[:, 1]) > 1e-3
    assert shown.has_base
    kinfeas("dataset", "shown", "run.csv", "--out", "set", code=0)
    about = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert about["total_episodes"] == 2
