from collections import Counter

import numpy as np

from kinfeas.benchmark import evaluations as module
from kinfeas.benchmark.evaluations import CEILING, PART, WorkspaceSamples, plan_evaluations
from kinfeas.benchmark.runs import Run
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.evaluate import evaluate, prepare
from kinfeas.jobs.job import run_jobs
from kinfeas.jobs.local import Local
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr
from tests.benchmark.benchmark_cases import PYBULLET, SMALL, study


def small(*overrides):
    return plan_evaluations(study(SMALL, *overrides), [])


def test_plan():
    planned = [(job.robot, job.task, job.variant, job.policy, job.row) for job in small()]
    assert planned == [
        ("hsr", "ggr", "", CEILING, ""),
        ("hsr", "ggr", "", "pretrained", ""),
        ("hsr", "ggr", "", "follow_ee", ""),
        ("hsr", "pick_place", "", CEILING, ""),
        ("hsr", "pick_place", "", "pretrained", ""),
        ("tiago", "ggr", "", CEILING, ""),
        ("tiago", "ggr", "", "pretrained", ""),
        ("tiago", "ggr", "", "pretrained", "feasibility filter"),
        ("tiago", "ggr", "", "follow_ee", ""),
        ("tiago", "pick_place", "", CEILING, ""),
        ("tiago", "pick_place", "", "pretrained", ""),
        ("tiago", "pick_place", "", "pretrained", "feasibility filter"),
        ("hsr", "ggr", "low", CEILING, ""),
        ("hsr", "ggr", "low", "pretrained", ""),
        ("hsr", "ggr", "low", "follow_ee", ""),
    ]


def test_rows_are_of_sac_and_runs_replace_the_shipped_policy(tmp_path):
    runs = [Run(tmp_path / name, "tiago", name, 3, "ggr") for name in ("sac", "td3")]
    planned = [(job.policy, job.row) for job in plan_evaluations(study(SMALL), runs)
            if (job.robot, job.task) == ("tiago", "pick_place")]  # fmt: skip
    assert planned == [(CEILING, ""), ("sac", ""), ("td3", ""), ("sac", "feasibility filter")]


def test_pybullet_episodes_come_in_parts_beside_the_analytic_world():
    planned = plan_evaluations(study(PYBULLET), [])
    parts = [job for job in planned if job.backend == "pybullet"]
    one = [job for job in parts if (job.robot, job.task, job.policy, job.row)
           == ("pr2", "ggr", "pretrained", "head_start")]  # fmt: skip
    assert [(job.first, job.episodes) for job in one] == [(0, PART), (PART, PART), (2 * PART, 3)]
    assert one[0].settings == ("world.head_start=3",)
    rows = Counter((job.robot, job.task, job.row) for job in parts if job.first == 0)
    assert rows["tiago", "ggr", "head_start"] == rows["pr2", "ggr", "no_objects"] == 0
    assert rows["tiago", "door", "no_objects"] == 1
    beside = [job for job in planned if job.backend == "analytic" and job.policy == "pretrained"]
    assert {job.settings for job in beside} == {
        ('world.filters=[{"name": "feasibility", "parameters": {}}]',)
    }


def test_jobs_with_other_results_have_other_files():
    one = small()
    assert len({job.name for job in one}) == len(one)
    assert [job.name for job in small()] == [job.name for job in one]
    for other in ("episodes=3", "evaluation_seed=2", "settings=['world.max_seconds=3']"):
        assert not {job.name for job in small(other)} & {job.name for job in one}
    physics, faster = (
        {job.name for job in plan_evaluations(study(PYBULLET, *more), [])}
        for more in ((), ("settings=['world.time_scale=1']",))
    )
    assert len(physics & faster) < len(physics) / 2


def test_a_policy_trained_anew_is_evaluated_anew(tmp_path):
    (tmp_path / module.WEIGHTS).write_bytes(b"one")
    run = Run(tmp_path, "hsr", "sac", 0, "ggr")

    def name():
        return next(
            job.name for job in plan_evaluations(study(SMALL), [run]) if job.policy == "sac"
        )

    before = name()
    (tmp_path / module.WEIGHTS).write_bytes(b"two")
    assert name() != before


def test_results_are_those_of_an_evaluation(tmp_path):
    few = [job for job in small("robots=[hsr]", "tasks=[ggr]") if job.policy != "pretrained"][:2]
    ceiling, found = run_jobs([one.job(tmp_path) for one in few], Local())
    chosen, policy = prepare(
        "follow_ee", "hsr", "ggr", episodes=2, overrides=["world.max_seconds=2.5"]
    )
    assert found == evaluate(chosen, policy, "follow_ee")
    assert ceiling.keys() == {"success", "success_low", "success_high"}


def test_workspace_samples():
    robot = load_robot("tiago")
    world = World(robot, ggr(), WorldConfig(max_failures=9, max_seconds=10.0), seed=1)
    samples = WorkspaceSamples()
    records = run_episodes(world, FollowEe(robot.base), 6, watch=samples)
    kept = {kind: np.array(points) for kind, points in samples.kept().items()}
    assert len(kept["infeasible"]) == records.failures.sum() > 0
    assert 0 < len(kept["feasible"]) <= records.steps.sum() / WorkspaceSamples.EVERY
    assert np.all(np.linalg.norm(kept["feasible"][:, :2], axis=1) < 1.5)
