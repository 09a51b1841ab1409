"""The script that puts a study's figures into the documentation leaves none of them old."""

import json
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "results_tables.py"))
README = (ROOT / "README.md").read_text()
PHYSICS = (ROOT / "docs" / "physics.md").read_text()
RESULTS = (ROOT / "docs" / "results.md").read_text()
POLICIES = ("sac", "look_ahead:sac", "whole_body_qp", "follow_ee_feedback")
FIGURES = {"success": 0.1234, "within_5cm": 0.5678, "jumps_per_episode": 9.87}


def cells():
    tasks, robots = SCRIPT["TASKS"], SCRIPT["ROBOTS"]
    return {(r, t, p): FIGURES for r in robots for t in tasks for p in POLICIES}


def test_every_row_of_the_readme_is_filled():
    filled = SCRIPT["fill_readme"](README, cells())
    for name in SCRIPT["ROBOTS"].values():
        assert f"| **{name}**, ours | **12.3 (56.8)** |" in filled
        assert f"| {name}, `whole_body_qp` | 12.3 (56.8) |" in filled
        assert f"| **{name}**, ours, looking ahead | **12.3 (56.8)** |" in filled
        assert f"| {name}, arm jumps an episode, ours | 9.87 |" in filled
        assert f"| {name}, arm jumps an episode, looking ahead | 9.87 |" in filled


def test_a_row_whose_name_has_changed_is_an_error():
    changed = README.replace("| TIAGo, `whole_body_qp` |", "| TIAGo, QP |")
    with pytest.raises(SystemExit, match=r"README\.md: no row 'TIAGo, `whole_body_qp`'; its fig"):
        SCRIPT["fill_readme"](changed, cells())


def test_pages_without_their_tables_are_errors(tmp_path):
    (tmp_path / "table.json").write_text(json.dumps([]))
    table = "World: analytic; of a study.\n\n## PR2\n\n## Arm jumps an episode\n\n![Picture](a)\n"
    filled = SCRIPT["fill_results"](RESULTS, table)
    assert "World: analytic; of a study.\n\n### PR2" in filled
    with pytest.raises(SystemExit, match=r"results\.md: no tables before 'How they learn'; its fi"):
        SCRIPT["fill_results"](RESULTS.replace("## How they learn", "## Learning"), table)
    assert SCRIPT["fill_physics"](PHYSICS, [tmp_path]) != PHYSICS
    with pytest.raises(SystemExit, match=r"physics\.md: no table that begins with 'robot' and"):
        SCRIPT["fill_physics"](PHYSICS.replace("| robot | task |", "| who | task |"), [tmp_path])
