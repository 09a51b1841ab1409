import json

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


def test_bad_input_is_one_line(kinfeas, tmp_path):
    for arguments in (("--robot", "pr3"), ("--minutes", "-1"), ("--set", "x=1")):
        assert is_one_line(kinfeas("demo", *arguments))
    assert not (tmp_path / "runs").exists()
