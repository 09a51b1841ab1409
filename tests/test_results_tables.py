"""The script that puts figures into the documentation leaves none of them old."""

import json
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SCRIPT = runpy.run_path(str(DOCS / "results_tables.py"))
README = (ROOT / "README.md").read_text()
PHYSICS = (DOCS / "physics.md").read_text()
TABLES = (DOCS / "reference" / "tables.md").read_text()
STUDY = json.loads((DOCS / "figures" / "study.json").read_text())
IN_PYBULLET = json.loads((DOCS / "figures" / "physics.json").read_text())
IN_MUJOCO = json.loads((DOCS / "figures" / "mujoco.json").read_text())


def test_the_pages_hold_what_the_record_says():
    assert SCRIPT["tables_page"](STUDY, IN_PYBULLET, IN_MUJOCO) == TABLES
    assert SCRIPT["fill_readme"](README, STUDY, IN_PYBULLET) == README
    assert SCRIPT["fill_physics"](PHYSICS, IN_PYBULLET, IN_MUJOCO) == PHYSICS
