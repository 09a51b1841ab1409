import json
from pathlib import Path

import pytest

from kinfeas import config
from kinfeas.benchmark.study import BenchmarkConfig, read_benchmark, restricted
from kinfeas.benchmark.trainings import to_train
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError

OUT = Path("out")


@pytest.mark.parametrize("name", ["study", "quick", "physics", "physics_quick"])
def test_the_note_of_a_study_says_nothing_that_options_change(name):
    assert not any(letter.isdigit() for letter in read_benchmark(f"benchmark/{name}").note)


def study(*overrides):
    return config.from_mapping(BenchmarkConfig, {}, "study", overrides)


def test_two_robots_of_one_name_are_refused(tmp_path):
    (tmp_path / "study.yaml").write_text("note: mine\n")
    path = registry.build("kinfeas.robots", "pr2", {})
    with pytest.raises(KinfeasError, match=f"pr2 and {path} are both 'pr2'"):
        read_benchmark(str(tmp_path / "study.yaml"), [f"robots=[pr2, {path}]"])


def test_fewer_robots():
    whole = study(
        "variants=[{label: x, task: ggr, parameters: {}, robots: [pr2, hsr]}]",
        "trainings=[{robot: pr2}, {robot: hsr}]",
    )
    kept = restricted(whole, {"hsr"})
    assert kept.robots == ("hsr",)
    assert [folder.name for _, folder in to_train(kept, OUT)] == ["hsr-sac-0"]
    with pytest.raises(KinfeasError, match="no robot 'fetch', only: hsr, pr2, tiago"):
        restricted(whole, {"fetch"})


TASK = "name: fetch\nplaces: {cup: {position: [2, 0, 0.8]}}\nsubgoals: [{place: cup}]\n"


@pytest.mark.parametrize(
    ("tasks", "words"),
    [
        (["a/fetch.yaml", "b/fetch.yaml"], r"b/fetch\.yaml: .* name of the task 'a/fetch\.yaml'"),
        (["a/ggr.yaml"], r"a/ggr\.yaml: .* name of the task 'ggr' in the tables; rename the file"),
        (["ggr", "ggr.yaml"], "name of the task 'ggr'"),
    ],
)
def test_two_tasks_of_one_name_are_refused(tmp_path, monkeypatch, tasks, words):
    monkeypatch.chdir(tmp_path)
    for name in ("study.yaml", *tasks):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(TASK if name != "study.yaml" else "note: mine\n")
    with pytest.raises(KinfeasError, match=words):
        read_benchmark("study.yaml", [f"tasks={json.dumps(tasks)}"])
    assert read_benchmark("study.yaml", ["tasks=[ggr]"]).tasks == ("ggr",)


def test_a_task_may_be_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fetch.yaml").write_text(TASK)
    (tmp_path / "study.yaml").write_text("tasks: [ggr, fetch.yaml]\n")
    assert read_benchmark("study.yaml").tasks == ("ggr", "fetch.yaml")


VARIANT = "{{label: {}, task: ggr, parameters: {{distance: [1, {}]}}, robots: [{}]}}"


@pytest.mark.parametrize(
    ("variants", "words"),
    [
        ([("x", 2, "pr2"), ("x", 3, "hsr, pr2")], "label 'x' of the task 'ggr' twice for a robot"),
        ([("x", 2, "pr2, pr2")], "label 'x' of the task 'ggr' twice for a robot"),
        ([("''", 2, "pr2")], "every entry of 'variants' must have a 'label' that is not empty"),
    ],
)
def test_variants_are_told_apart_by_their_labels(variants, words):
    told = ", ".join(VARIANT.format(*variant) for variant in variants)
    with pytest.raises(KinfeasError, match=words):
        study(f"variants=[{told}]")


def test_a_label_may_stand_for_other_parameters_of_another_robot():
    told = ", ".join(VARIANT.format("x", far, robot) for far, robot in ((2, "pr2"), (3, "hsr")))
    assert len(study(f"variants=[{told}]").variants) == 2


SUBGOAL = "subgoals: [{{place: cup, motion: {{generator: {}, parameters: {{{}}}}}}}]"


@pytest.mark.parametrize(
    ("subgoal", "words"),
    [
        (("leap", ""), "unknown motion generator 'leap'"),
        (("imitation", "model: gone.yaml"), r"gone\.yaml: cannot be read"),
        (("linear", "max_velocity: -1"), "max_velocity"),
    ],
)
@pytest.mark.parametrize("key", ["tasks", "variants"])
def test_a_motion_that_cannot_be_made_is_refused(tmp_path, monkeypatch, subgoal, words, key):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text("note: mine\n")
    (tmp_path / "fetch.yaml").write_text(
        TASK.replace("subgoals: [{place: cup}]", SUBGOAL.format(*subgoal))
    )
    said = {
        "tasks": "tasks=[fetch.yaml]",
        "variants": "variants=[{label: x, task: fetch.yaml, parameters: {}, robots: [pr2]}]",
    }
    with pytest.raises(KinfeasError, match=words):
        read_benchmark("study.yaml", [said[key]])


def test_with_physics_a_scene_that_is_missing_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text("tasks: [fetch.yaml]\n")
    scene = "scene: {name: gone.yaml, success: {object: box, joint: lid}}\n"
    (tmp_path / "fetch.yaml").write_text(TASK + scene)
    read_benchmark("study.yaml")
    with pytest.raises(KinfeasError, match=r"gone\.yaml: cannot be read"):
        read_benchmark("study.yaml", ["physics={}"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("baselines={follow_me: [ggr]}", "unknown baseline 'follow_me'.*follow_ee"),
        ("baselines={follow_ee: [fly]}", "unknown task 'fly'"),
        ("trainings=[{robot: fetch}]", "unknown robot 'fetch'"),
        ("variants=[{label: x, task: ggr, parameters: {colour: 1}, robots: [pr2]}]", "colour"),
        ("trainings=[{robot: pr2, algorithm: ppo}]", "'sac', 'td3'"),
        ("seeds=[1, 1]", "none twice"),
        ("robots=[]", "at least one"),
        ("episodes=0", ">= 1"),
        ("episodes=1000001", "at most 1000000"),
        ("policies=both", "'pretrained'"),
        (
            "aids=[{robots: [pr2]}]",
            "one of 'feasibility_filter' and 'rollout_planner' must be true",
        ),
        (
            "aids=[{feasibility_filter: true}, {feasibility_filter: true, tasks: [ggr]}]",
            "help pr2 on ggr in the same way",
        ),
        ("aids=[{feasibility_filter: true, robots: [fetch]}]", "unknown robot 'fetch'"),
        ("aids=[{feasibility_filter: true, tasks: [fly]}]", "unknown task 'fly'"),
        ("aids=[{yelds: true}]", "unknown key 'aids.*yelds'"),
        ("tasks=[ggr, fly]", "unknown task 'fly'"),
        ("robots=[pr3]", "unknown robot 'pr3'"),
        (
            "physics={settings: ['world.slw=1']}",
            r"^the settings of 'physics': world\.slw",
        ),
        ("physics={settings: ['world.slow_down=1', 'task.distance=[1, 2]']}", "not task.KEY"),
        ("physics={rows: {plain: {settings: [rollout.horizon=3]}}}", "not rollout.KEY"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, override, words):
    (tmp_path / "study.yaml").write_text("note: mine\n")
    with pytest.raises(KinfeasError, match=words):
        read_benchmark(str(tmp_path / "study.yaml"), [override])
