"""The plan of a benchmark: the jobs that a study comes to."""

from collections.abc import Sequence
from dataclasses import replace

from kinfeas.benchmark.job import CEILING, Job, world_for
from kinfeas.benchmark.runs import Run
from kinfeas.benchmark.study import PLAIN, BenchmarkConfig, PhysicsBenchmark, row_settings
from kinfeas.benchmark.trainings import takes_pretrained
from kinfeas.envs.world import WorldConfig
from kinfeas.policies import pretrained
from kinfeas.policies.loading import BASELINES
from kinfeas.robots.loading import load_robot

PART = 20
"""Episodes that are run and kept together: all that a stop can lose of a cell."""

Source = tuple[str, str, int | None]
"""What a policy is called, what `load_policy` takes, and its training seed."""


def plan_jobs(study: BenchmarkConfig, runs: Sequence[Run]) -> list[Job]:
    """Return what has to be computed for a study: of each robot and task ceiling and policies.

    Args:
        study: Which robots, tasks and baselines.
        runs: The learned policies; robots without any have the one that comes with the package, if
            the study says so, or none.
    """
    trials: list[tuple[str, str, dict[str, object], str]] = [
        (robot, task, {}, "") for robot in study.robots for task in study.tasks
    ]
    trials += [
        (robot, variant.task, variant.parameters, variant.label)
        for variant in study.variants
        for robot in variant.robots
        if robot in study.robots and variant.task in study.tasks and study.physics is None
    ]
    jobs: list[Job] = []
    for robot, task, parameters, variant in trials:
        learned = _learned(study, runs, robot)
        baselines: list[Source] = [
            (name, name, None) for name, on in study.baselines.items() if task in on
        ]
        aided = [] if variant else _aided(study, learned, robot, task)
        world = _analytic_world(study, robot)
        sources = [(CEILING, CEILING, None), *learned, *aided, *baselines]
        analytic = [
            Job(
                robot=robot,
                task=task,
                parameters=parameters,
                variant=variant,
                policy=policy,
                source=source,
                training_seed=seed,
                episodes=study.episodes,
                seed=study.evaluation_seed,
                world=world_for(policy, world),
            )
            for policy, source, seed in sources
        ]
        jobs += analytic
        if study.physics is not None:
            jobs += _with_physics(study.physics, analytic)
    return jobs


def _learned(study: BenchmarkConfig, runs: Sequence[Run], robot: str) -> list[Source]:
    """Return for each learned policy of a robot its name, what `load_policy` takes, its seed."""
    name = load_robot(robot).name
    own = [run for run in runs if run.robot == name]
    if not own and takes_pretrained(study, robot):
        return [(pretrained.NAME, pretrained.NAME, None)]
    return [(run.algorithm, str(run.folder), run.seed) for run in own]


def _aided(
    study: BenchmarkConfig, learned: Sequence[Source], robot: str, task: str
) -> list[Source]:
    """Return a robot's learned policies with each of the study's aids."""
    return [
        (f"{aid.prefix}{policy}", source, seed)
        for aid in study.aids
        if aid.holds(robot, task)
        for policy, source, seed in learned
        if policy != "td3"
    ]


def _analytic_world(study: BenchmarkConfig, robot: str) -> WorldConfig:
    """Return the world of what stands in the table, or beside the one of physics, of a robot.

    The feasibility filter is on there where it is in the plain row.
    """
    if study.physics is None:
        return study.world
    plain = row_settings(study.physics, study.physics.rows[PLAIN], robot)
    filters = tuple(one for one in plain.filters if one.name == "feasibility")
    return replace(study.world, filters=study.world.filters or filters)


def _with_physics(study: PhysicsBenchmark, analytic: Sequence[Job]) -> list[Job]:
    """Return the jobs of one robot on one task with physics, each one's episodes in parts.

    Args:
        study: Its rows. Learned policies stand in all of them, what is aided and baselines in the
            plain one alone.
        analytic: The same without physics, and the ceiling.
    """
    jobs, robot, task = [], analytic[0].robot, analytic[0].task
    for name, row in study.rows.items():
        if not row.holds(robot, task):
            continue
        settings, plain = row_settings(study, row, robot), name == PLAIN
        for job in analytic:
            if job.policy != CEILING and (plain or not (job.aided or job.source in BASELINES)):
                world = world_for(job.policy, settings)
                jobs += _parts(replace(job, variant="" if plain else name, world=world))
    return jobs


def _parts(job: Job) -> list[Job]:
    return [
        replace(job, first=first, episodes=min(PART, job.episodes - first))
        for first in range(0, job.episodes, PART)
    ]
