import json
import shutil
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "target_source.py"


def test_the_ee_follows_a_source_of_the_working_directory(kinfeas, tmp_path):
    shutil.copy(EXAMPLE, tmp_path / "circles.py")
    relaxed = [f"guards.{name}=5" for name in ("max_age", "max_period", "max_clock_skew")]
    settings = [word for one in relaxed for word in ("--set", one)]
    kinfeas(
        "servo", "--robot", "pr2", "--backend", "analytic", "--source", "circles:Circle",
        "--seconds", "2", "--record", "run.csv", "--json", "run.json", *settings, code=0,
    )  # fmt: skip
    found = json.loads((tmp_path / "run.json").read_text())
    assert (found["failures"], found["time_scale"]) == (0, 1.0)
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()[1:]]
    column = lines[0].index("desired.y")
    assert lines[1][column] != lines[-1][column]
