"""Small studies, and cells as a benchmark finds them, made up."""

from kinfeas import config
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.benchmark.plan import PART, plan_jobs
from kinfeas.benchmark.study import BenchmarkConfig
from kinfeas.benchmark.table import tabulate
from kinfeas.envs.world import evaluation_world

SMALL = {
    "robots": ["pr2", "hsr"],
    "tasks": ["ggr", "pick_place"],
    "baselines": {"follow_ee": ["ggr"]},
    "policies": "pretrained",
    "episodes": 2,
    "world": {"max_seconds": 2.5},
    "variants": [
        {"label": "low", "task": "ggr", "parameters": {"heights": [0.5, 0.6]}, "robots": ["hsr"]}
    ],
}


def small_study(*overrides):
    """Return a study of two robots and two tasks."""
    return config.from_mapping(BenchmarkConfig, SMALL, "small", overrides)


PHYSICS_STUDY = {
    "robots": ["pr2", "hsr"],
    "tasks": ["ggr", "door"],
    "policies": "pretrained",
    "baselines": {"follow_ee": ["ggr"]},
    "episodes": 2 * PART + 3,
    "physics": {
        "rows": {
            "plain": {},
            "head_start": {"settings": ["world.head_start=3"], "robots": ["pr2"]},
            "no_objects": {"settings": ["world.objects=false"], "tasks": ["door"]},
        }
    },
}


def physics_plan(*overrides):
    """Return the jobs of a study with physics."""
    return plan_jobs(config.from_mapping(BenchmarkConfig, PHYSICS_STUDY, "study", overrides), [])


def job(robot, task, policy, seed=None, variant=""):
    return Job(robot, task, {}, variant, policy, policy, seed, 100, 1, evaluation_world())


def figures(success):
    return {
        "episodes": 100,
        "success": success,
        "within_5cm": success,
        "ik_failures_per_episode": 2.0,
        "mean_deviation_m": 0.001,
        "joint_jumps_per_episode": 0.5,
        "mean_steps": 400.0,
    }


def result(success, learned=False):
    found = {"figures": figures(success)}
    points = {"feasible": [[0.5, 0.1, 0.8]] * 9, "infeasible": [[0.2, 0.0, 0.5]]}
    return {**found, "workspace": points} if learned else found


def findings():
    """Return jobs and results: two robots, two tasks, three seeds, one baseline, a variant."""
    ceiling = {"figures": {"success": 0.98, "low": 0.93, "high": 1.0}}
    jobs, results = [], []
    trials = [("pr2", "ggr", ""), ("pr2", "door", ""), ("hsr", "ggr", "")]
    for robot, task, variant in [*trials, ("pr2", "ggr", "goals up to 1.4 m")]:
        jobs.append(job(robot, task, CEILING, variant=variant))
        results.append(ceiling)
        for seed, success in ((0, 0.90), (1, 0.92), (2, 0.94)):
            jobs.append(job(robot, task, "sac", seed, variant))
            results.append(result(success, learned=True))
        jobs.append(job(robot, task, "follow_ee", variant=variant))
        results.append(result(0.6))
    return jobs, results


def cells():
    """Return the table of `findings`."""
    return tabulate(*findings())
