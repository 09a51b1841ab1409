import pytest

from kinfeas.config.recipes import default_engine

PLANNED = ["obstacle_distance", "path_planner", "feasibility"]
EVALUATE = ("evaluate", "--policy", "follow_ee", "--robot", "hsr", "--episodes", "1")
SHORT = (*EVALUATE, "--set", "world.max_seconds=0.5")
ENGINE = default_engine()


@pytest.fixture
def evaluate(kinfeas):
    """Return a function that returns the JSON of `kinfeas evaluate`."""
    return lambda *arguments: kinfeas(*arguments, "--json", "out.json", code=0).facts


def test_options_of_physics(evaluate):
    words = ("--world", ENGINE, "--task", "drawer", "--no-objects")
    words += ("--robot", "tiago")
    figures = evaluate(*SHORT, *words, "--head-start", "0.2", "--time-scale", "0.5")
    assert (figures["head_start"], figures["time_scale"]) == (0.2, 0.5)
    assert (figures["task_success"], figures["filters"]) == (None, PLANNED)
    assert figures["base_collisions"] is not None
    names = ["obstacle_distance", "feasibility"]
    assert evaluate(*SHORT, *words, "--filters", ",".join(names))["filters"] == names
    assert evaluate(*SHORT, *words, "--filters", "none")["filters"] == []


def test_adapters_of_a_file(evaluate, tmp_path):
    (tmp_path / "mine.yaml").write_text("adapters: [base_noise, {name: head_start, seconds: 1}]")
    figures = evaluate(*SHORT, "--adapters", "mine.yaml", "--ablation")
    assert (figures["adapters"], figures["head_start"]) == (["base_noise", "head_start"], 1.0)
    one, other = ["base_noise"], ["head_start"]
    assert {label: row["adapters"] for label, row in figures["ablation"].items()} == {
        "none": [], "base_noise": one, "head_start": other, "no base_noise": other,
        "no head_start": one,
    }  # fmt: skip


@pytest.mark.parametrize("world", ["analytic", ENGINE])
def test_episode_as_picture_film_and_page(kinfeas, tmp_path, world):
    pytest.importorskip("viser")
    outputs = ("--video", "four.png", "--replay", "page.html", "--picture", "episode.png")
    outcome = kinfeas(*SHORT, "--world", world, *outputs, "--episode", "0", code=0)
    assert set(outcome.out.splitlines()[-3:]) == {"four.png", "page.html", "episode.png"}
    for name in ("four.png", "episode.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert b"<html" in (tmp_path / "page.html").read_bytes()[:1000].lower()
