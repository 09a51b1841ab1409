import json
import shutil
from collections import Counter
from dataclasses import replace

import pytest

from kinfeas.benchmark.config import read_benchmark
from kinfeas.benchmark.evaluations import CEILING, PART, TrainedRun, plan_evaluations
from kinfeas.config.recipes import robot_file
from kinfeas.core.errors import KinfeasError
from kinfeas.evaluation.evaluate import configure, evaluate
from kinfeas.jobs.job import build_engine, run_jobs
from kinfeas.policies.loading import load_policy
from kinfeas.policies.network import WEIGHTS
from kinfeas.robots.loading import load_robot
from tests.benchmark.benchmark_cases import PYBULLET, SMALL, study


def small(settings=None):
    return plan_evaluations(study(SMALL, settings), [])


def test_plan():
    planned = [(job.robot, job.task, job.variant, job.policy, job.row) for job in small()]
    plain, filtered = [(CEILING, ""), ("pretrained", "")], ("pretrained", "feasibility filter")
    expected = {
        ("hsr", "ggr", ""): [*plain, ("follow_ee", "")],
        ("hsr", "pick_place", ""): plain,
        ("tiago", "ggr", ""): [*plain, filtered, ("follow_ee", "")],
        ("tiago", "pick_place", ""): [*plain, filtered],
        ("hsr", "ggr", "low"): [*plain, ("follow_ee", "")],
    }
    assert planned == [(*place, *row) for place, rows in expected.items() for row in rows]


def test_runs_replace_the_shipped_policy(tmp_path):
    runs = [TrainedRun(tmp_path, "tiago", 3, "ggr")]
    planned = [(job.policy, job.row) for job in plan_evaluations(study(SMALL), runs)
            if (job.robot, job.task) == ("tiago", "pick_place")]  # fmt: skip
    assert planned == [(CEILING, ""), ("sac", ""), ("sac", "feasibility filter")]


def test_pybullet_episodes_come_in_parts_beside_the_analytic_world():
    planned = plan_evaluations(study(PYBULLET), [])
    parts = [job for job in planned if job.backend == "pybullet"]
    late = [job for job in parts if (job.task, job.row) == ("ggr", "head_start")]
    assert [(job.first, job.episodes) for job in late] == [(0, PART), (PART, PART), (2 * PART, 3)]
    assert late[0].settings == {"world": {"head_start": 3}}
    rows = Counter((job.robot, job.task, job.row) for job in parts if job.first == 0)
    assert rows["tiago", "ggr", "head_start"] == rows["pr2", "ggr", "no_objects"] == 0
    assert rows["tiago", "door", "no_objects"] == 1
    beside = [job for job in planned if job.backend == "analytic" and job.policy == "pretrained"]
    for job in beside:
        filters = [spec["name"] for spec in job.settings["world.filters"]]
        assert filters == ["path_planner", "feasibility"]
    alone = next(job for job in parts if (job.robot, job.policy) == ("tiago", "follow_ee"))
    names = [spec["name"] for spec in alone.settings["world"]["filters"]]
    assert names == ["obstacle_distance", "feasibility"]


def test_jobs_with_other_results_have_other_files():
    names = [job.name for job in small()]
    assert len(set(names)) == len(names)
    assert [job.name for job in small()] == names
    for change in ({"episodes": 3}, {"evaluation_seed": 2}, {"settings.world": {"max_seconds": 3}}):
        assert not {job.name for job in small(change)} & set(names)


@pytest.mark.parametrize("data", [SMALL, PYBULLET])
def test_parameters_of_tasks_count_for_ceilings_and_references_too(data, tmp_path):
    heights = [2.5, 2.6]  # out of reach
    settings = {"settings.task.heights": heights, "robots": ["tiago"], "tasks": ["ggr"]}
    planned = plan_evaluations(study(data, settings), [])
    assert all(case.settings["task"] == {"heights": heights} for case in planned)
    ceiling = next(case for case in planned if case.policy == CEILING)
    (result,) = run_jobs([ceiling.job(tmp_path)], build_engine("local"))
    assert result["success"] == 0.0


def test_a_robot_that_changes_is_evaluated_anew(tmp_path):
    shutil.copytree(robot_file("hsr").parent, tmp_path / "hsr")
    case = replace(small()[0], robot=str(tmp_path / "hsr"))
    names = [case.name]
    (tmp_path / "hsr" / "recipes.yaml").write_text("analytic: {world: {max_failures: 3}}")
    names.append(case.name)
    (tmp_path / "hsr" / "recipes.yaml").unlink()
    assert len({*names, case.name}) == 3


def test_a_motion_learned_anew_is_evaluated_anew(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reach.yaml").write_text("first")
    motion = {"generator": "imitation", "parameters": {"model": "reach.yaml"}}
    places = {"cup": {"position": [2.0, 0.0, 0.8]}}
    task = {"name": "own", "places": places, "subgoals": [{"place": "cup", "motion": motion}]}
    (tmp_path / "task.yaml").write_text(json.dumps(task))
    own = replace(small()[0], task=str(tmp_path / "task.yaml"))
    (tmp_path / "ee.csv").write_text("first")
    cases = [own, replace(small()[0], settings={"task": {"motion": {"file": "ee.csv"}}})]
    names = [case.name for case in cases]
    for file in ("reach.yaml", "ee.csv"):
        (tmp_path / file).write_text("second")
    assert not {case.name for case in cases} & set(names)


def test_a_policy_trained_anew_is_evaluated_anew(tmp_path):
    (tmp_path / WEIGHTS).write_bytes(b"one")
    (tmp_path / "policy.json").write_text("{}")
    run = TrainedRun(tmp_path, "hsr", 0, "ggr")

    before, after = [], []
    for names in (before, after):
        names += [job.name for job in plan_evaluations(study(SMALL), [run]) if job.policy == "sac"]
        (tmp_path / WEIGHTS).write_bytes(b"two")
    assert before
    assert not set(before) & set(after)


def test_results_are_those_of_an_evaluation(tmp_path):
    jobs = small({"robots": ["hsr"], "tasks": ["ggr"]})
    few = [case.job(tmp_path) for case in jobs if case.policy != "pretrained"][:2]
    ceiling, metrics = run_jobs(few, build_engine("local"))
    robot = load_robot("hsr")
    settings = {
        "world.max_seconds": 2.5,
        "world.filters": ["obstacle_distance", "feasibility"],
    }  # no planner
    config = configure(robot, "ggr", episodes=2, settings=settings)
    expected = evaluate(config, load_policy("follow_ee", robot), "follow_ee")
    small_ones = expected.keys() - {"settings", "version", "per_episode"}
    assert metrics == {key: expected[key] for key in small_ones}
    assert ceiling.keys() == {"success", "success_low", "success_high"}


@pytest.mark.parametrize("name", ["study", "quick", "physics", "physics_quick"])
def test_shipped_benchmarks_are_valid(name):
    read = read_benchmark(f"benchmark/{name}")
    assert read.backend == ("pybullet" if name.startswith("physics") else "analytic")


VARIANT = {"label": "x", "task": "ggr", "parameters": {"distance": [1, 2]}, "robots": ["pr2"]}


@pytest.mark.parametrize(("settings", "named"), [
    ({"baselines": {"follow_me": ["ggr"]}}, "follow_me"),
    ({"tasks": ["ggr", "fly"]}, "fly"),
    ({"seeds": [1, 1]}, "seeds"),
    ({"variants": [VARIANT, VARIANT]}, "variants"),
    ({"variants": [VARIANT | {"parameters": {"colour": 1}}]}, "colour"),
    ({"rows": [{"label": "a"}, {"label": "a", "tasks": ["ggr"]}]}, "rows"),
    ({"rows": [{"label": "a", "settings": {"world.slw": 1}}]}, "slw"),
])  # fmt: skip
def test_the_wrong_key_or_value_is_named(tmp_path, settings, named):
    (tmp_path / "mine.yaml").write_text("note: mine\n")
    with pytest.raises(KinfeasError, match=named):
        read_benchmark(str(tmp_path / "mine.yaml"), settings)
