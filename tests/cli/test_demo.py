import json
import re
import shlex
from html import unescape

import pytest

from tests.cli.conftest import TINY, is_one_line

QUICK = ("--minutes", "0.01", "--episodes", "3", *TINY)


def test_demo_reports_beside_baselines_and_ceiling_and_overwrites_nothing(kinfeas, tmp_path):
    taken = tmp_path / "runs" / "demo"
    taken.mkdir(parents=True)
    (taken / "mine").write_text("keep")
    (tmp_path / "runs" / "demo-2").write_text("keep")
    outcome = kinfeas("demo", *QUICK)
    assert outcome.code == 0, outcome.err
    assert "runs/demo is there already: this run goes to runs/demo-3" in outcome.err
    assert [path.name for path in taken.iterdir()] == ["mine"]
    for name in ("trained policy", "follow_ee", "follow_ee_feedback", "ceiling", "paper"):
        assert name in outcome.out
    run = tmp_path / "runs" / "demo-3"
    assert f"report: {run.relative_to(tmp_path) / 'report.html'}" in outcome.out
    page = (run / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "kinfeas demo --robot pr2 --minutes 0.01 --seed 0" in page
    assert json.loads((run / "evaluation.json").read_text())["ceiling"] > 0.0
    for picture in ("learning_curve.png", "episodes.png"):
        assert (run / picture).read_bytes().startswith(b"\x89PNG")


TASK = """
name: fetch
places: {my cup: {position: [1.5, [-0.5, 0.5], 0.8]}}
subgoals: [{place: my cup}]
"""


def test_the_reports_lines_make_its_figures_again(kinfeas, tmp_path):
    (tmp_path / "my task.yaml").write_text(TASK)
    ours = {"task": "my task.yaml", "robot": "hsr", "seed": 4}
    ours["task_parameters"] = {"places": {"my cup": {"rpy": [0, 0, 1]}}}
    chosen = [f"--set={key}={json.dumps(value)}" for key, value in ours.items()]
    outcome = kinfeas("demo", *QUICK, *chosen, "--out", "my run", "--minutes", "0.0123456789")
    assert outcome.code == 0, outcome.err
    page = unescape((tmp_path / "my run" / "report.html").read_text())
    lines = re.search(r"<pre>(.*?)</pre>", page, re.DOTALL)[1].splitlines()
    again, judged, *baselines, ceiling = (shlex.split(line)[1:] for line in lines)

    assert " ".join(again[:11]) == (
        "demo --robot pr2 --minutes 0.0123456789 --seed 0 --episodes 3 --out my run"
    )
    assert again[12::2] == [*TINY[1::2], *(one.removeprefix("--set=") for one in chosen)]
    assert set(again[11::2]) == {"--set"}
    assert [line[0] for line in (judged, *baselines, ceiling)] == ["evaluate"] * 3 + ["ceiling"]
    assert kinfeas(*judged, "--json", "judged.json").code == 0
    figures = json.loads((tmp_path / "my run" / "evaluation.json").read_text())
    assert json.loads((tmp_path / "judged.json").read_text()) == figures
    assert (figures["robot"], figures["task"], figures["seed"]) == ("hsr", "fetch", 5)
    assert kinfeas(*ceiling, "--json", "ceiling.json").code == 0
    assert json.loads((tmp_path / "ceiling.json").read_text())["ceiling"] == figures["ceiling"]


def test_bad_input_is_one_line(kinfeas, tmp_path):
    for arguments in (("--robot", "pr3"), ("--minutes", "-1"), ("--set", "x=1")):
        assert is_one_line(kinfeas("demo", *arguments))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("out", ["", ".", ".."])
def test_a_folder_without_a_name_of_its_own_is_one_line(kinfeas, tmp_path, out):
    outcome = kinfeas("demo", *QUICK, "--out", out)
    assert is_one_line(outcome), outcome.err
    assert "--out: must end in the name of a folder" in outcome.err
    assert not list(tmp_path.iterdir())
