from pathlib import Path

import pytest

from kinfeas.benchmark.job import CEILING
from kinfeas.benchmark.plan import PART, plan_jobs
from kinfeas.benchmark.runs import Run
from kinfeas.benchmark.study import read_benchmark
from tests.benchmark.benchmark_cases import physics_plan, small_study


def test_each_robot_and_task_has_its_ceiling_and_its_policies():
    jobs = plan_jobs(small_study(), [])
    told = [(job.robot, job.task, job.variant, job.policy) for job in jobs]
    assert len(set(told)) == len(told) == 5 + 5 + 3
    for robot, task, variant in {one[:3] for one in told}:
        assert (robot, task, variant, CEILING) in told
        assert (robot, task, variant, "pretrained") in told
        assert ((robot, task, variant, "follow_ee") in told) == (task == "ggr")
    assert {job.episodes for job in jobs} == {2}
    assert next(job.parameters for job in jobs if job.variant) == {"heights": [0.5, 0.6]}


@pytest.mark.parametrize("fewer", ["robots=[pr2]", "tasks=[pick_place]"])
def test_what_takes_no_part_is_left_out(fewer):
    asked = small_study(fewer)
    jobs = plan_jobs(asked, [])
    assert {job.robot for job in jobs} == set(asked.robots)
    assert {job.task for job in jobs} == set(asked.tasks)
    assert not any(job.variant for job in jobs)


def test_runs_go_before_what_is_shipped():
    runs = [Run(Path(f"run-{seed}"), "pr2", "td3", seed, "ggr") for seed in (4, 5)]
    jobs = plan_jobs(small_study("policies=either"), runs)
    found = {(job.robot, job.policy, job.training_seed) for job in jobs if job.task == "ggr"}
    learned = {one for one in found if one[1] not in (CEILING, "follow_ee")}
    assert learned >= {("pr2", "td3", 4), ("pr2", "td3", 5)}
    assert ("pr2", "pretrained", None) not in learned


def test_what_is_aided_is_a_row_of_its_own():
    runs = [Run(Path(f"run-{name}"), "pr2", name, 4, "ggr") for name in ("sac", "td3")]
    aids = (
        "aids=[{feasibility_filter: true}, {rollout_planner: true}, "
        "{feasibility_filter: true, rollout_planner: true}]"
    )
    jobs = plan_jobs(small_study("policies=either", "robots=[pr2]", "tasks=[ggr]", aids), runs)
    aided = [job for job in jobs if ":" in job.policy]
    assert [(job.policy, job.source, job.world.feasibility_filter) for job in aided] == [
        ("feasibility_filter:sac", "run-sac", True),
        ("rollout_planner:sac", "rollout_planner:run-sac", False),
        ("rollout_planner:feasibility_filter:sac", "rollout_planner:run-sac", True),
    ]
    assert not any(job.world.feasibility_filter for job in jobs if job not in aided)
    assert not any(job.variant for job in aided)
    assert aided[-1].name == "pr2-ggr-rollout_planner-feasibility_filter-sac-4"


def test_an_aid_helps_the_robots_and_tasks_that_it_names():
    jobs = plan_jobs(
        small_study("aids=[{feasibility_filter: true, robots: [pr2], tasks: [ggr]}]"), []
    )
    aided = [job for job in jobs if ":" in job.policy]
    assert {(job.robot, job.task, job.policy) for job in aided} == {
        ("pr2", "ggr", "feasibility_filter:pretrained")
    }


def test_episodes_come_in_parts_beside_the_same_without_physics():
    jobs = physics_plan()
    parts = [job for job in jobs if job.physical and (job.robot, job.task) == ("pr2", "ggr")]
    assert [(job.policy, job.variant) for job in parts[::3]] == [
        ("pretrained", ""),
        ("follow_ee", ""),
        ("pretrained", "head_start"),
    ]
    assert [(job.first, job.episodes) for job in parts[:3]] == [(0, PART), (PART, PART), (40, 3)]
    assert {job.world.slow_down for job in parts} == {2.0}
    assert [job.world.head_start for job in parts[::3]] == [0.0, 0.0, 3.0]
    analytic = [job.policy for job in jobs if not job.physical and job.robot == "pr2"]
    assert analytic == [CEILING, "pretrained", "follow_ee", CEILING, "pretrained"]
    of_hsr = {job.variant for job in jobs if job.physical and job.robot == "hsr"}
    assert of_hsr == {"", "no_objects"}


def test_settings_of_the_study_reach_every_row():
    worlds = [
        job.world for job in physics_plan("physics.settings=['world.slow_down=3']") if job.physical
    ]
    assert {world.slow_down for world in worlds} == {3.0}


def test_a_row_may_have_no_tasks():
    jobs = physics_plan("physics.rows.plain.tasks=[]", "robots=[pr2]")
    assert {job.variant for job in jobs if job.physical} == {"head_start", "no_objects"}


@pytest.mark.parametrize(
    ("aid", "policy"),
    [
        ("rollout_planner: true", "rollout_planner:pretrained"),
        ("feasibility_filter: true", "feasibility_filter:pretrained"),
    ],
)
def test_what_is_aided_stands_in_the_plain_row(aid, policy):
    jobs = physics_plan(f"aids=[{{{aid}, robots: [hsr], tasks: [ggr]}}]")
    aided = [job for job in jobs if job.policy == policy]
    assert {(job.robot, job.task) for job in aided} == {("hsr", "ggr")}
    assert {job.variant for job in aided if job.physical} == {""}
    assert {job.world.feasibility_filter for job in aided} == {
        policy == "feasibility_filter:pretrained"
    }
    assert {job.physical for job in aided} == {True, False}


def test_bases_yield_without_physics_as_they_do_with_it():
    worlds = {
        (job.robot, job.physical, job.policy, job.world.feasibility_filter)
        for job in physics_plan()
    }
    for physical in (True, False):
        assert ("pr2", physical, "pretrained", True) in worlds
        assert ("pr2", physical, "follow_ee", True) in worlds
        assert ("hsr", physical, "pretrained", False) in worlds
    settings = "physics.settings=['world.feasibility_filter=false']"
    assert not any(job.world.feasibility_filter for job in physics_plan(settings))


@pytest.mark.parametrize("name", ["benchmark/physics", "benchmark/physics_quick"])
def test_the_shipped_studies_can_be_read(name):
    study = read_benchmark(name)
    assert study.physics is not None
    assert {"plain", "head_start", "no_objects"} == set(study.physics.rows)
    assert plan_jobs(study, [])
