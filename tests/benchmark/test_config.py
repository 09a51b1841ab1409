import json

import pytest

from kinfeas.benchmark.config import read_benchmark, restricted
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from tests.benchmark.benchmark_cases import study

TASK = "name: fetch\nplaces: {cup: {position: [2, 0, 0.8]}}\nsubgoals: [{place: cup}]\n"


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text("note: mine\n")
    return "study.yaml"


@pytest.mark.parametrize("name", ["study", "quick", "physics", "physics_quick"])
def test_shipped_benchmarks_are_valid(name):
    read = read_benchmark(f"benchmark/{name}")
    assert read.backend == ("pybullet" if name.startswith("physics") else "analytic")


def test_fewer_robots():
    whole = study({}, "trainings=[{robot: pr2}, {robot: hsr}]")
    assert restricted(whole, {"hsr"}).robots == ("hsr",)
    with pytest.raises(KinfeasError, match="fetch"):
        restricted(whole, {"fetch"})


def test_robots_and_tasks_need_different_names(mine, tmp_path):
    path = registry.build("kinfeas.robots", "pr2", {})
    with pytest.raises(KinfeasError, match="robots"):
        read_benchmark(mine, [f"robots=[pr2, {path}]"])
    for folder in "ab":
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "fetch.yaml").write_text(TASK)
    assert read_benchmark(mine, ["tasks=[ggr, a/fetch.yaml]"]).tasks == ("ggr", "a/fetch.yaml")
    with pytest.raises(KinfeasError, match="tasks"):
        read_benchmark(mine, [f"tasks={json.dumps(['a/fetch.yaml', 'b/fetch.yaml'])}"])


VARIANT = "{label: x, task: ggr, parameters: {distance: [1, 2]}, robots: [pr2]}"


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("baselines={follow_me: [ggr]}", "follow_me"),
        ("tasks=[ggr, fly]", "fly"),
        ("robots=[]", "robots"),
        ("seeds=[1, 1]", "seeds"),
        (f"variants=[{VARIANT}, {VARIANT}]", "variants"),
        ("variants=[{label: x, task: ggr, parameters: {colour: 1}, robots: [pr2]}]", "colour"),
        ("rows=[{label: a}, {label: a, tasks: [ggr]}]", "rows"),
        ("rows=[{label: ''}]", "rows"),
        ("rows=[{label: a, settings: ['world.slw=1']}]", "slw"),
    ],
)
def test_the_wrong_key_or_value_is_named(mine, override, named):
    with pytest.raises(KinfeasError, match=named):
        read_benchmark(mine, [override])
