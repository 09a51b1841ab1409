import json
from dataclasses import replace
from importlib import resources

import pytest

from kinfeas.benchmark import cells as module
from kinfeas.benchmark.cells import compute, run_jobs
from kinfeas.benchmark.identity import identity
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.benchmark.speed import random_network
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.physics import PhysicsSettings
from kinfeas.evaluation.evaluate import evaluation_world
from kinfeas.policies.loading import BASELINES
from kinfeas.policies.network import write_network
from kinfeas.robots.loading import load_robot

WORLD = replace(evaluation_world(), max_seconds=3.0)


def job(policy="follow_ee", source=None, **changes):
    plain = Job("pr2", "ggr", {}, "", policy, source or policy, None, 4, 1, WORLD)
    return replace(plain, **changes)


@pytest.fixture
def run(tmp_path):
    robot = load_robot("pr2")
    folder = tmp_path / "run"
    folder.mkdir()
    write_network(random_network(robot, width=4), folder, robot, {})
    return folder


@pytest.fixture
def counted(monkeypatch):
    done = []

    def counting(one):
        done.append(one)
        return compute(one)

    monkeypatch.setattr(module, "compute", counting)
    return done


def test_what_is_done_is_not_done_again(tmp_path, run, counted):
    jobs = [job(CEILING), job(), job("sac", str(run), training_seed=3)]
    first = run_jobs(jobs, tmp_path / "cells")
    assert len(counted) == 3
    told = []
    assert run_jobs(jobs, tmp_path / "cells", on_done=told.append) == first
    assert len(counted) == 3
    assert told == jobs
    run_jobs([*jobs, job("follow_ee_feedback")], tmp_path / "cells")
    assert [one.policy for one in counted[3:]] == ["follow_ee_feedback"]


def test_looking_ahead_is_another_cell(tmp_path, run):
    plain, ahead = (job("sac", f"{before}{run}") for before in ("", "rollout_planner:"))
    assert identity(plain)["policy"] != identity(ahead)["policy"]
    assert 0.0 <= compute(ahead)["figures"]["success"] <= 1.0


def test_looking_ahead_is_judged_with_physics_too(run):
    pytest.importorskip("pybullet")
    short = PhysicsSettings(max_seconds=1.0)
    found = compute(job("sac", f"rollout_planner:{run}", world=short, episodes=1))
    assert found["records"]["steps"][0] > 0


def test_a_stop_keeps_the_cells_before_it(tmp_path, monkeypatch, counted):
    jobs = [job(), job("follow_ee_feedback"), job(CEILING)]

    def interrupted(one):
        if one is jobs[1]:
            raise KeyboardInterrupt
        return compute(one)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(module, "compute", interrupted)
        run_jobs(jobs, tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    run_jobs(jobs, tmp_path)
    assert counted == jobs[1:]


@pytest.mark.parametrize(
    "changes",
    [
        {"episodes": 5},
        {"seed": 2},
        {"task": "ggr_restricted"},
        {"parameters": {"orientation": "so3"}},
        {"robot": "hsr"},
        {"source": "follow_ee_feedback"},
        {"world": replace(WORLD, max_seconds=3.1)},
        {"world": replace(WORLD, feasibility_filter=True)},
    ],
)
def test_everything_that_matters_tells_cells_apart(changes):
    assert identity(job()) == identity(job())
    assert identity(job()) != identity(job(**changes))


def test_other_weights_are_another_cell(run):
    before = identity(job("sac", str(run)))
    assert identity(job("td3", str(run))) == before
    robot = load_robot("pr2")
    write_network(random_network(robot, width=5), run, robot, {})
    assert identity(job("sac", str(run))) != before


TASK = "name: fetch\nplaces: {cup: {position: [2, 0, 0.8]}}\nsubgoals: [{place: cup}]\n"


@pytest.mark.parametrize("path", ["fetch.yaml", "./fetch.yaml", "{}/fetch.yaml"])
def test_a_task_by_path_is_found_again_until_its_file_changes(tmp_path, monkeypatch, counted, path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fetch.yaml").write_text(TASK)
    one = job(task=path.format(tmp_path))
    first = run_jobs([one], tmp_path / "cells")
    assert run_jobs([one], tmp_path / "cells") == first
    assert len(counted) == 1
    (tmp_path / "fetch.yaml").write_text(TASK.replace("0.8", "0.9"))
    assert run_jobs([one], tmp_path / "cells") != first
    assert len(counted) == 2
    names = [path.name for path in (tmp_path / "cells").iterdir()]
    assert len(names) == 2
    assert all(name.startswith("pr2-fetch-follow_ee-") for name in names)


MOTION = "subgoals: [{place: cup, motion: {generator: imitation, parameters: {model: grasp.yaml}}}]"


def test_another_model_of_a_motion_is_another_cell(tmp_path):
    shipped = (resources.files("kinfeas.plugins") / "models" / "door_grasp.yaml").read_text()
    (tmp_path / "grasp.yaml").write_text(shipped)
    (tmp_path / "fetch.yaml").write_text(TASK.replace("subgoals: [{place: cup}]", MOTION))
    one = job(task=str(tmp_path / "fetch.yaml"))
    before = identity(one)
    assert identity(one) == before
    (tmp_path / "grasp.yaml").write_text(shipped.replace("duration: ", "duration: 1"))
    assert identity(one) != before


def test_other_waypoints_among_parameters_are_another_cell(tmp_path):
    way = tmp_path / "way.csv"
    way.write_text("x,y,z,qx,qy,qz,qw\n-0.3,0,0,0,0,0,1\n0,0,0,0,0,0,1\n")
    motion = {"generator": "waypoints", "parameters": {"file": str(way)}}
    one = job(parameters={"motion": motion})
    before = identity(one)
    way.write_text(way.read_text().replace("-0.3", "-0.2"))
    assert identity(one) != before


def test_cells_of_named_tasks_are_found_where_they_have_always_been():
    told = identity(job())
    assert told["task"] == "ggr"
    assert sorted(told) == [
        "episodes", "format", "parameters", "policy", "robot", "robot_digest", "seed", "task",
        "version", "world",
    ]  # fmt: skip
    assert sorted(told["world"]) == [
        "adapters", "dt", "ik", "max_failures", "max_seconds", "reward",
    ]  # fmt: skip
    assert identity(job(task="door")).keys() == told.keys()
    assert job(task="my.task").name == "pr2-my.task-follow_ee"


def test_a_task_file_that_is_gone_is_named(tmp_path):
    with pytest.raises(KinfeasError, match=r"gone\.yaml: cannot be read"):
        identity(job(task=str(tmp_path / "gone.yaml")))


def test_a_learned_policy_leaves_samples_of_the_workspace(run):
    found = compute(job("sac", str(run)))
    assert found["workspace"].keys() == {"feasible", "infeasible"}
    assert compute(job()).keys() == {"figures"}
    assert compute(job(CEILING))["figures"].keys() == {"success", "low", "high"}


def test_a_broken_file_is_named(tmp_path):
    run_jobs([job()], tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_text(path.read_text()[:50])
    with pytest.raises(KinfeasError, match=f"{path.name}: broken; remove it"):
        run_jobs([job()], tmp_path)


@pytest.mark.parametrize(
    "broken",
    [
        lambda held: [],
        lambda held: ["identity"],
        lambda held: "identity",
        lambda held: {**held, "figures": {}},
        lambda held: {**held, "figures": [1.0]},
        lambda held: {**held, "figures": {**held["figures"], "within_5cm": None}},
        lambda held: {key: value for key, value in held.items() if key != "figures"},
        lambda held: {**held, "workspace": {"feasible": [[0.0, 1.0]]}},
    ],
)
def test_a_file_that_lacks_what_it_should_hold_is_named(tmp_path, broken):
    run_jobs([job()], tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_text(json.dumps(broken(json.loads(path.read_text()))))
    with pytest.raises(KinfeasError, match=f"{path.name}: broken; remove it"):
        run_jobs([job()], tmp_path)


def test_a_baseline_that_cannot_be_is_refused_before_anything_is_found(tmp_path, monkeypatch):
    def missing(robot):
        raise KinfeasError("no such library")

    monkeypatch.setitem(BASELINES, "whole_body_qp", missing)
    with pytest.raises(KinfeasError, match="no such library"):
        run_jobs([job(), job("whole_body_qp")], tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_cell_is_not_taken(tmp_path, counted):
    run_jobs([job()], tmp_path)
    (path,) = tmp_path.iterdir()
    held = json.loads(path.read_text())
    held["identity"]["seed"] = 9
    path.write_text(json.dumps(held))
    run_jobs([job()], tmp_path)
    assert len(counted) == 2


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(KinfeasError, match="cannot be written"):
        run_jobs([job()], tmp_path / "file" / "cells")


@pytest.mark.slow
def test_no_result_depends_on_the_number_of_processes(tmp_path):
    jobs = [job(), job("follow_ee_feedback"), job(CEILING)]
    assert run_jobs(jobs, tmp_path / "a", processes=2) == run_jobs(jobs, tmp_path / "b")
