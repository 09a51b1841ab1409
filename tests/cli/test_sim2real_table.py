import json

import pytest

from tests.cli.conftest import is_one_line

SHORT = ("--policy", "follow_ee", "--episodes", "2", "--set", "world.max_seconds=0.5")


def test_the_table_says_what_each_adapter_costs(kinfeas, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("adapters: [{name: base_noise}, {name: head_start, parameters: {seconds: 1}}]")
    outcome = kinfeas("evaluate", *SHORT, "--adapters", str(path), "--json", "out.json")
    assert outcome.code == 0, outcome.err
    for name in ("none", "base_noise", "head_start", "all", "ceiling"):
        assert name in outcome.out
    data = json.loads((tmp_path / "out.json").read_text())
    assert [cost["adapter"] for cost in data["costs"]] == [
        "none",
        "base_noise",
        "head_start",
        "all",
    ]
    assert data["success"] == data["costs"][-1]["success"]
    assert data["sweeps"] == []


def test_the_picture_is_drawn_and_its_figures_are_held(kinfeas, tmp_path):
    pictured = ("--adapters", "ideal", "--picture", "out.png", "--json", "out.json")
    outcome = kinfeas("evaluate", *SHORT, *pictured)
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    assert outcome.out.endswith("\nout.png\n")
    sweeps = json.loads((tmp_path / "out.json").read_text())["sweeps"]
    assert [sweep["adapter"] for sweep in sweeps] == ["command_latency", "base_noise", "head_start"]
    # With nothing in the list, an axis begins where nothing is changed.
    assert len({json.dumps(sweep["points"][0]) for sweep in sweeps}) == 1


def test_settings_of_the_world_keep_their_adapters(kinfeas, tmp_path):
    own = ("--set", "world.adapters=[{name: base_noise, parameters: {linear: 3.0}}]")
    for name, more in (("plain", ()), ("noisy", own)):
        kinfeas("evaluate", *SHORT, *more, "--adapters", "ideal", "--json", f"{name}.json")
    plain, noisy = (
        json.loads((tmp_path / f"{name}.json").read_text()) for name in ("plain", "noisy")
    )
    assert noisy["mean_deviation_m"] > plain["mean_deviation_m"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--adapters", "hars"), "did you mean 'harsh'"),
        (("--adapters", "paper", "--picture", "none/out.png"), "cannot be written"),
    ],
)
def test_bad_input_is_one_line(kinfeas, arguments, words):
    outcome = kinfeas("evaluate", *SHORT, *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err


def test_a_broken_list_is_one_line(kinfeas, tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "adapters: [{name: base_noise, parameters: {linear: [2, 1]}}]"
    )
    outcome = kinfeas("evaluate", *SHORT, "--adapters", "mine.yaml")
    assert is_one_line(outcome), outcome.err
    assert "a range must ascend" in outcome.err
