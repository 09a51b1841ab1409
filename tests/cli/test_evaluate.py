import json

import pytest

from kinfeas.config.recipes import default_engine

EVALUATE = ("evaluate", "--policy", "follow_ee", "--robot", "hsr", "--episodes", "2")
SHORT = (*EVALUATE, "--set", "world.max_seconds=0.5")
ENGINE = default_engine()


@pytest.fixture
def evaluate(kinfeas, tmp_path):
    """Return a function that returns the JSON of `kinfeas evaluate`."""

    def run(*arguments):
        kinfeas(*arguments, "--json", "out.json", code=0)
        return json.loads((tmp_path / "out.json").read_text())

    return run


def test_metrics_and_ceiling(evaluate):
    figures = evaluate(*SHORT, "--seed", "3")
    assert (figures["episodes"], figures["policy"], figures["seed"]) == (2, "follow_ee", 3)
    assert figures["success_low"] <= figures["success"] <= figures["success_high"]
    ceiling = evaluate("ceiling", "--robot", "hsr", "--episodes", "2", "--seed", "3")
    assert ceiling["ceiling"] == figures["ceiling"] == ceiling["convergence"][-1]
    assert len(ceiling["convergence"]) == len(ceiling["base_poses"])
    path = evaluate("ceiling", "--robot", "hsr", "--episodes", "2", "--path")
    assert path["path"] is True


def test_filters_replace_those_of_the_robot(evaluate):
    words = ("--robot", "tiago", "--world", ENGINE, "--episodes", "1", "--no-objects")
    for given, names in (
        ((), ["feasibility"]),
        (("--filters", "none"), []),
        (("--filters", "obstacle_distance,feasibility"), ["obstacle_distance", "feasibility"]),
    ):
        assert evaluate(*SHORT, *words, *given)["filters"] == names


def test_options_of_physics(evaluate):
    words = ("--world", ENGINE, "--episodes", "1", "--task", "drawer", "--no-objects")
    figures = evaluate(*SHORT, *words, "--head-start", "0.2", "--time-scale", "0.5")
    assert (figures["head_start"], figures["time_scale"]) == (0.2, 0.5)
    assert figures["task_success"] is None
    assert figures["base_collisions"] is not None


def test_adapters_of_a_file(evaluate, tmp_path):
    (tmp_path / "mine.yaml").write_text("adapters: [base_noise, {name: head_start, seconds: 1}]")
    figures = evaluate(*SHORT, "--adapters", "mine.yaml")
    assert figures["adapters"] == ["base_noise", "head_start"]
    assert figures["head_start"] == 1.0
    rows = evaluate(*SHORT, "--adapters", "mine.yaml", "--ablation")["ablation"]
    assert {label: row["adapters"] for label, row in rows.items()} == {
        "none": [],
        "base_noise": ["base_noise"],
        "head_start": ["head_start"],
        "no base_noise": ["head_start"],
        "no head_start": ["base_noise"],
    }


@pytest.mark.parametrize("world", ["analytic", ENGINE])
def test_episode_as_picture_film_and_page(kinfeas, tmp_path, world):
    pytest.importorskip("viser")
    outputs = ("--video", "four.png", "--replay", "page.html", "--picture", "episode.png")
    outcome = kinfeas(*SHORT, "--world", world, *outputs, "--episode", "1", code=0)
    assert set(outcome.out.splitlines()[-3:]) == {"four.png", "page.html", "episode.png"}
    for name in ("four.png", "episode.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert b"<html" in (tmp_path / "page.html").read_bytes()[:1000].lower()
