import json
import re
from pathlib import Path

import pytest

from kinfeas.benchmark import findings as module
from kinfeas.benchmark.cells import run_jobs
from kinfeas.benchmark.findings import (
    Findings,
    check_out,
    figures_of_runs,
    write_pictures,
    write_tables,
)
from kinfeas.benchmark.plan import plan_jobs
from kinfeas.benchmark.runs import Run
from kinfeas.benchmark.speed import random_network
from kinfeas.core.errors import KinfeasError
from kinfeas.policies import pretrained
from kinfeas.policies.network import write_network
from kinfeas.robots.loading import load_robot
from kinfeas.viz.episodes import episodes_figure
from tests.benchmark.benchmark_cases import figures, small_study


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    for name in ("pr2", "hsr"):
        robot, folder = load_robot(name), tmp_path / "shipped" / name
        folder.mkdir(parents=True)
        write_network(random_network(robot, width=4), folder, robot, {})
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path / "shipped")


def test_everything_is_written(shipped, tmp_path, monkeypatch):
    titles = []

    def titled(robot, recordings, above):
        titles.extend(above)
        return episodes_figure(robot, recordings, above)

    monkeypatch.setattr(module, "episodes_figure", titled)
    aid = "rollout_planner: true, robots: [pr2], tasks: [ggr]"
    asked = small_study(f"aids=[{{{aid}}}, {{feasibility_filter: true, {aid}}}]")
    jobs = plan_jobs(asked, [])
    findings = Findings(asked, [], jobs, run_jobs(jobs, tmp_path / "cells"))
    pictures = write_pictures(findings, tmp_path)
    told = r"goal (reached|missed), (no|\d+) failures?, \d+ s"
    for title, task in zip(titles, ["ggr", "pick_place"] * 2, strict=True):
        assert re.fullmatch(f"{task}: {told}", title)
    names = ["table.png", "workspace.png", "examples-pr2.png", "examples-hsr.png"]
    assert [path.name for path in pictures] == names
    write_tables(findings, ["kinfeas benchmark"], pictures, tmp_path)
    entries = json.loads((tmp_path / "table.json").read_text())
    assert len(entries) == len(findings.cells) == 10
    text = (tmp_path / "table.md").read_text()
    assert "learned, pretrained" in text
    assert "learned, pretrained, rollout planner**" in text
    assert "learned, pretrained, rollout planner and feasibility filter**" in text
    for path in pictures:
        assert f"({path.name})" in text


def test_figures_of_runs_are_told_by_task():
    runs = [Run(Path("run"), "pr2", "sac", 0, "ggr")]
    asked = small_study("robots=[pr2]", "variants=[]", "aids=[{feasibility_filter: true}]")
    jobs = plan_jobs(asked, runs)
    results = [{"figures": {"success": 0.5}} for _ in jobs]
    assert figures_of_runs(Findings(asked, runs, jobs, results)) == {
        Path("run"): {task: {"seed": 1, "success": 0.5} for task in ("ggr", "pick_place")}
    }


def test_a_task_by_path_goes_by_its_name(tmp_path):
    runs = [Run(Path("run"), "pr2", "sac", 0, "ggr")]
    asked = small_study("robots=[pr2]", "variants=[]", f"tasks=[{tmp_path}/fetch.yaml]")
    jobs = plan_jobs(asked, runs)
    told = figures(0.5) | {"low": 0.4, "high": 0.6}
    findings = Findings(asked, runs, jobs, [{"figures": told} for _ in jobs])
    assert [cell.task for cell in findings.cells] == ["fetch"]
    assert findings.cells[0].paper_success is None
    assert list(figures_of_runs(findings)[Path("run")]) == ["fetch"]


def test_a_place_that_is_no_folder(tmp_path):
    check_out(tmp_path / "a" / "b")
    (tmp_path / "file").write_text("")
    with pytest.raises(KinfeasError, match="--out needs a folder"):
        check_out(tmp_path / "file")
    with pytest.raises(KinfeasError, match="cannot be written"):
        check_out(tmp_path / "file" / "b")
