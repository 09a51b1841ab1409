"""The script that puts figures into the documentation leaves none of them old."""

import json
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SCRIPT = runpy.run_path(str(DOCS / "results_tables.py"))
README = (ROOT / "README.md").read_text()
PHYSICS = (DOCS / "physics.md").read_text()
RESULTS = (DOCS / "results.md").read_text()
STUDY = json.loads((DOCS / "figures" / "study.json").read_text())
IN_PYBULLET = json.loads((DOCS / "figures" / "physics.json").read_text())
NEW = {"success": 0.1234, "paper_success": 0.456, "ceiling": 0.789}


def test_the_pages_hold_what_the_record_says():
    assert SCRIPT["fill_results"](RESULTS, STUDY) == RESULTS
    assert SCRIPT["fill_readme"](README, STUDY, IN_PYBULLET) == README
    assert SCRIPT["fill_physics"](PHYSICS, IN_PYBULLET) == PHYSICS


def test_every_row_of_the_readme_is_filled():
    record, physics = ([{**cell, **NEW} for cell in cells] for cells in (STUDY, IN_PYBULLET))
    filled = SCRIPT["fill_readme"](README, record, physics)
    assert "| **PR2** in PyBullet, 3 s head start | **12.3** |" in filled
    assert "| **TIAGo** in PyBullet, rollout planner | **12.3** |" in filled
    for robot, name in SCRIPT["ROBOTS"].items():
        _, filters = SCRIPT["FILTERS"][robot]
        assert f"| **{name}**, ours | **12.3** |" in filled
        assert f"| **{name}**, {filters} | **12.3** |" in filled
        assert f"| {name}, `whole_body_qp` | 12.3 |" in filled
        assert f"| {name}, paper | 45.6 |" in filled
        assert f"| {name}, ceiling | 78.9 |" in filled
        assert f"| {name} in PyBullet, paper | 45.6 |" in filled


def test_a_row_whose_name_has_changed_is_an_error():
    changed = README.replace("| TIAGo, `whole_body_qp` |", "| TIAGo, QP |")
    with pytest.raises(SystemExit, match=r"README\.md: no row 'TIAGo, `whole_body_qp`'; its fig"):
        SCRIPT["fill_readme"](changed, STUDY, IN_PYBULLET)
