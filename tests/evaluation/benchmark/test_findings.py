import json
import re
from pathlib import Path

import pytest

from kinfeas import config, pretrained, registry
from kinfeas.errors import KinfeasError
from kinfeas.evaluation.benchmark import findings as module
from kinfeas.evaluation.benchmark.cells import run_jobs
from kinfeas.evaluation.benchmark.findings import (
    Findings,
    check_out,
    figures_of_runs,
    plan_jobs,
    write_pictures,
    write_tables,
)
from kinfeas.evaluation.benchmark.job import CEILING
from kinfeas.evaluation.benchmark.runs import Run
from kinfeas.evaluation.benchmark.study import StudyConfig
from kinfeas.evaluation.pictures.episodes import episodes_figure
from kinfeas.evaluation.speed import random_network
from kinfeas.policy import write_network
from tests.evaluation.benchmark.benchmark_cases import figures

SMALL = {
    "robots": ["pr2", "hsr"],
    "tasks": ["ggr", "pick_place"],
    "baselines": {"follow_ee": ["ggr"]},
    "policies": "pretrained",
    "episodes": 2,
    "world": {"max_seconds": 2.5},
    "variants": [
        {"label": "low", "task": "ggr", "parameters": {"heights": [0.5, 0.6]}, "robots": ["hsr"]}
    ],
}


def study(*overrides):
    return config.from_mapping(StudyConfig, SMALL, "small", overrides)


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    for name in ("pr2", "hsr"):
        robot, folder = registry.load_robot(name), tmp_path / "shipped" / name
        folder.mkdir(parents=True)
        write_network(random_network(robot, hidden=4), folder, robot, {})
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path / "shipped")


def test_each_robot_and_task_has_its_ceiling_and_its_policies():
    jobs = plan_jobs(study(), [])
    told = [(job.robot, job.task, job.variant, job.policy) for job in jobs]
    assert len(set(told)) == len(told) == 5 + 5 + 3
    for robot, task, variant in {one[:3] for one in told}:
        assert (robot, task, variant, CEILING) in told
        assert (robot, task, variant, "pretrained") in told
        assert ((robot, task, variant, "follow_ee") in told) == (task == "ggr")
    assert {job.episodes for job in jobs} == {2}
    assert next(job.parameters for job in jobs if job.variant) == {"heights": [0.5, 0.6]}


@pytest.mark.parametrize("fewer", ["robots=[pr2]", "tasks=[pick_place]"])
def test_what_takes_no_part_is_left_out(fewer):
    asked = study(fewer)
    jobs = plan_jobs(asked, [])
    assert {job.robot for job in jobs} == set(asked.robots)
    assert {job.task for job in jobs} == set(asked.tasks)
    assert not any(job.variant for job in jobs)


def test_runs_go_before_what_is_shipped():
    runs = [Run(Path(f"run-{seed}"), "pr2", "td3", seed, "ggr") for seed in (4, 5)]
    jobs = plan_jobs(study("policies=either"), runs)
    found = {(job.robot, job.policy, job.training_seed) for job in jobs if job.task == "ggr"}
    learned = {one for one in found if one[1] not in (CEILING, "follow_ee")}
    assert learned >= {("pr2", "td3", 4), ("pr2", "td3", 5)}
    assert ("pr2", "pretrained", None) not in learned


def test_what_is_aided_is_a_row_of_its_own():
    runs = [Run(Path(f"run-{name}"), "pr2", name, 4, "ggr") for name in ("sac", "td3")]
    aids = "aids=[{yields: true}, {look_ahead: true}, {yields: true, look_ahead: true}]"
    jobs = plan_jobs(study("policies=either", "robots=[pr2]", "tasks=[ggr]", aids), runs)
    aided = [job for job in jobs if ":" in job.policy]
    assert [(job.policy, job.source, job.world.yields) for job in aided] == [
        ("yielding:sac", "run-sac", True),
        ("look_ahead:sac", "look_ahead:run-sac", False),
        ("look_ahead:yielding:sac", "look_ahead:run-sac", True),
    ]
    assert not any(job.world.yields for job in jobs if job not in aided)
    assert not any(job.variant for job in aided)
    assert aided[-1].name == "pr2-ggr-look_ahead-yielding-sac-4"


def test_an_aid_helps_the_robots_and_tasks_that_it_names():
    jobs = plan_jobs(study("aids=[{yields: true, robots: [pr2], tasks: [ggr]}]"), [])
    aided = [job for job in jobs if ":" in job.policy]
    assert {(job.robot, job.task, job.policy) for job in aided} == {
        ("pr2", "ggr", "yielding:pretrained")
    }


def test_everything_is_written(shipped, tmp_path, monkeypatch):
    titles = []

    def titled(robot, recordings, above):
        titles.extend(above)
        return episodes_figure(robot, recordings, above)

    monkeypatch.setattr(module, "episodes_figure", titled)
    aid = "look_ahead: true, robots: [pr2], tasks: [ggr]"
    asked = study(f"aids=[{{{aid}}}, {{yields: true, {aid}}}]")
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
    assert "learned, pretrained, looking ahead**" in text
    assert "learned, pretrained, looking ahead and yielding**" in text
    for path in pictures:
        assert f"({path.name})" in text


def test_figures_of_runs_are_told_by_task():
    runs = [Run(Path("run"), "pr2", "sac", 0, "ggr")]
    asked = study("robots=[pr2]", "variants=[]", "aids=[{yields: true}]")
    jobs = plan_jobs(asked, runs)
    results = [{"figures": {"success": 0.5}} for _ in jobs]
    assert figures_of_runs(Findings(asked, runs, jobs, results)) == {
        Path("run"): {task: {"seed": 1, "success": 0.5} for task in ("ggr", "pick_place")}
    }


def test_a_task_by_path_goes_by_its_name(tmp_path):
    runs = [Run(Path("run"), "pr2", "sac", 0, "ggr")]
    asked = study("robots=[pr2]", "variants=[]", f"tasks=[{tmp_path}/fetch.yaml]")
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
