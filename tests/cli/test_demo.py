import json
import os
import re
import shlex
from html import unescape

import pytest

from tests.cli.conftest import TINY

QUICK = ("--steps", "64", "--episodes", "3", *TINY)
TASK = """
name: fetch
places: {my cup: {position: [1.5, [-0.5, 0.5], 0.8]}}
subgoals: [{place: my cup}]
"""


@pytest.mark.slow
def test_commands_of_the_report_reproduce_its_figures(kinfeas, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # starts no processes
    (tmp_path / "my task.yaml").write_text(TASK)
    existing = tmp_path / "my run"
    existing.mkdir()
    ours = {"task": "my task.yaml", "robot": "hsr", "seed": 4}
    ours["task_parameters"] = {"places": {"my cup": {"rpy": [0, 0, 1]}}}
    changes = [f"--set={key}={json.dumps(value)}" for key, value in ours.items()]
    outcome = kinfeas("demo", *QUICK, *changes, "--out", "my run", code=0)
    for name in ("trained policy", "follow_ee", "follow_ee_feedback", "ceiling"):
        assert name in outcome.out
    assert list(existing.iterdir()) == []
    run = tmp_path / "my run-2"
    page = (run / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    for picture in ("learning_curve.png", "episodes.png"):
        assert (run / picture).read_bytes().startswith(b"\x89PNG")
    lines = re.search(r"<pre>(.*?)</pre>", unescape(page), re.DOTALL)[1].splitlines()
    again, evaluation, *baselines, ceiling = (shlex.split(line)[1:] for line in lines)
    assert again[:3] == ["demo", "--robot", "pr2"]
    assert again[-8:][1::2] == [change.removeprefix("--set=") for change in changes]
    assert [line[0] for line in (evaluation, *baselines, ceiling)] == ["evaluate"] * 3 + ["ceiling"]
    figures = json.loads((run / "evaluation.json").read_text())
    assert (figures["robot"], figures["task"], figures["seed"]) == ("hsr", "fetch", 5)
    found = kinfeas(*evaluation, "--json", "out.json", code=0).facts
    assert found | {"settings": {}} == figures | {"steps": found["steps"]}
    bound = kinfeas(*ceiling, "--json", "out.json", code=0).facts
    assert bound["ceiling"] == figures["ceiling"]
