"""Small benchmarks, and made-up results of one."""

from dataclasses import replace

from kinfeas import config
from kinfeas.benchmark.config import BenchmarkConfig
from kinfeas.benchmark.evaluations import CEILING, Evaluation
from kinfeas.benchmark.table import tabulate

SMALL = {
    "robots": ["hsr", "tiago"],
    "tasks": ["ggr", "pick_place"],
    "baselines": {"follow_ee": ["ggr"]},
    "policies": "pretrained",
    "rows": [{"label": "feasibility filter", "filters": ["feasibility"], "robots": ["tiago"]}],
    "variants": [
        {"label": "low", "task": "ggr", "parameters": {"heights": [0.5, 0.6]}, "robots": ["hsr"]}
    ],
    "episodes": 2,
    "settings": {"world.max_seconds": 2.5},
}

PYBULLET = {
    "robots": ["pr2", "tiago"],
    "tasks": ["ggr", "door"],
    "policies": "pretrained",
    "baselines": {"follow_ee": ["ggr"]},
    "episodes": 43,
    "backend": "pybullet",
    "rows": [
        {"label": "head_start", "settings": {"world.head_start": 3}, "robots": ["pr2"]},
        {"label": "no_objects", "settings": {"world.backend_parameters.objects": False},
         "tasks": ["door"]},
    ],
}  # fmt: skip


def study(data=None, settings=None):
    return config.from_mapping(BenchmarkConfig, data or {}, "study", settings)


def result(success, *, episodes=100, **changes):
    unknown = ("task_success", "base_collisions", "arm_collisions", "collision_free_rate")
    return {
        "episodes": episodes, "success": success, "within_5cm": success,
        "ik_failures_per_episode": 2.0, "mean_deviation_m": 0.001, "joint_jumps_per_episode": 0.5,
        "mean_steps": 400.0, **dict.fromkeys(unknown), "filters": [], "time_scale": 1.0,
        "head_start": 0.0, **changes,
    }  # fmt: skip


def cells():
    """Return cells of two robots and tasks, three seeds, a row, a baseline and a variant."""
    results = []
    ceiling = {"success": 0.98, "success_low": 0.93, "success_high": 1.0}
    for robot, task, variant in (
        ("pr2", "ggr", ""), ("pr2", "door", ""), ("hsr", "ggr", ""),
        ("pr2", "ggr", "goals up to 1.4 m"),
    ):  # fmt: skip
        case = Evaluation(robot, robot, task, CEILING, CEILING, 100, 1, variant=variant)
        results += [(case, ceiling), (replace(case, policy="follow_ee"), result(0.6))]
        for seed, success in enumerate((0.90, 0.92, 0.94)):
            learned = replace(case, policy="sac", source=f"runs/{seed}", training_seed=seed)
            results.append((learned, result(success)))
        filtered = replace(learned, row="feasibility filter")
        results.append((filtered, result(0.97, filters=["feasibility"])))
    return tabulate(results, "analytic")
