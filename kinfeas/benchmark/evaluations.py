"""Stages of a benchmark: trainings and evaluations, one job for each policy, task and seed."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kinfeas import __version__, config
from kinfeas.benchmark.config import BenchmarkConfig, Training, read_benchmark, restricted
from kinfeas.config import PluginSpec, Settings, nested
from kinfeas.config.recipes import robot_file
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require
from kinfeas.core.files import is_path, named_file_hashes, reading
from kinfeas.evaluation.evaluate import configure, evaluate, read_settings
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.io.policy_metadata import WEIGHTS, Trained, policy_folder, read_best
from kinfeas.jobs.job import Job, Result, training_job
from kinfeas.policies.loading import PRETRAINED, load_policy, trained_folder, trained_policies
from kinfeas.policies.network import copy_network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task, task_name
from kinfeas.training.config import TrainConfig, duration, load_recipe
from kinfeas.training.run import read_settings as read_training
from kinfeas.training.run import with_initial_policy

RunJobs = Callable[[Sequence[Job], str], list[Result]]
"""Runs jobs and returns their results; the text names their kind, such as `trainings`."""

LEARNED_POLICIES = ("sac", PRETRAINED)

CEILING = "ceiling"
"""Policy of an evaluation that measures the reachability of a task's goals."""

_LEFT_OUT = {"settings", "version", "per_episode"}
"""Metrics that are left out, to keep the files small."""

PART = 20
"""Episodes of one evaluation with physics: the most that an interruption loses."""


@dataclass(frozen=True)
class TrainedRun:
    """A training run: its folder and settings."""

    folder: Path
    robot: str
    seed: int
    task: str
    label: str = ""  # label of its rows; runs without a label are averaged over their seeds


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One evaluation of a policy on a task, or the ceiling of the task."""

    robot: str  # name or YAML file, as of the task
    robot_name: str
    task: str
    policy: str  # name in the table: `sac`, `pretrained`, a baseline or `ceiling`
    source: str  # name for `load_policy`
    episodes: int
    seed: int  # seed of the episodes
    training_seed: int | None = None
    first: int = 0  # number of the first episode
    backend: str = "analytic"
    settings: dict[str, object] = field(default_factory=dict)  # values by key of the evaluation
    row: str = ""  # label of the further row that it belongs to
    variant: str = ""  # label of the further table that it belongs to
    parameters: dict[str, object] = field(default_factory=dict)  # keyword parameters of the task

    @property
    def task_name(self) -> str:
        """Name of the task in tables."""
        return task_name(self.task)

    @property
    def name(self) -> str:
        """Name of the result file: readable parts, and a hash of all that determines the result."""
        parts = [
            self.robot, self.task, _weights(self) or self.source, self.episodes, self.seed,
            self.first, self.backend, self.settings, self.parameters,
        ]  # fmt: skip
        if is_path(self.robot):
            path = robot_file(self.robot)
            files = [path, load_robot(self.robot).urdf_path]
            files += filter(Path.is_file, [path.with_name("recipes.yaml")])
            parts += [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
        if is_path(self.task):
            task = config.to_mapping(load_task(self.task, self.parameters))
            parts += [task, *named_file_hashes(task)]
        parts += named_file_hashes([self.settings, self.parameters])
        digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:10]
        return f"{self.robot_name}-{self.task_name}-{self.policy}-{self.backend}-{digest}"

    def job(self, folder: Path) -> Job:
        """Return the job whose result is a file in `folder`."""
        return Job(compute, self, folder / f"{self.name}.json")


def run_benchmark(
    name: str,
    settings: Settings,
    worlds: Sequence[str],
    folders: Sequence[Path],
    out: Path,
    run_jobs: RunJobs,
) -> tuple[BenchmarkConfig, list[TrainedRun], list[tuple[Evaluation, Result]]]:
    """Run a benchmark; return it, its training runs, and its evaluations in `worlds` with results.

    Training runs in `folders`, if there are any, replace those of the benchmark.

    Raises:
        KinfeasError: If the benchmark or a run is invalid, the benchmark is for another world, or
            an extra is missing that its trainings or baselines need.
    """
    benchmark, runs = read_benchmark(name, settings), find_runs(folders)
    if runs:
        benchmark = restricted(benchmark, {run.robot for run in runs})
    backend = benchmark.backend
    if backend not in worlds or (len(worlds) > 1 and "analytic" in worlds):
        world = ",".join(worlds)
        raise KinfeasError(f"{name}: its 'backend', {backend}, does not fit --world {world}")
    trainings = [] if runs else plan_runs(benchmark, out)
    if "seeds" in settings and not trainings:
        raise KinfeasError("'seeds' is for trainings, and this benchmark has none")
    if not all(job.path.exists() for job in trainings):
        require("torch", "stable_baselines3")
    planned = plan_evaluations(benchmark, runs)
    _check_table(out / "table.json", planned)
    missing = [case for case in planned if not case.job(out / "results").path.exists()]
    # A missing extra is an error before hours of work.
    baselines = [case for case in missing if case.policy not in (*LEARNED_POLICIES, CEILING)]
    for source, robot in dict.fromkeys((case.source, case.robot) for case in baselines):
        load_policy(source, load_robot(robot))
    if trainings:
        run_jobs(trainings, "trainings")
        runs = [read_run(job.path.parent) for job in trainings]
    plans = [plan_evaluations(replace(benchmark, backend=world), runs) for world in worlds]
    # All physics engines have the same evaluations in the analytic world.
    unique = {(case.name, case.row, case.variant): case for cases in plans for case in cases}
    jobs = [case.job(out / "results") for case in unique.values()]
    return benchmark, runs, list(zip(unique.values(), run_jobs(jobs, "evaluations"), strict=True))


def _check_table(path: Path, planned: Sequence[Evaluation]) -> None:
    """Raise KinfeasError if an old table has robots or tasks that are not planned."""
    if not path.exists():
        return
    with reading(path):
        content = path.read_bytes()
    try:
        before = {(cell["robot"], cell["task"]) for cell in json.loads(content)}
    except (ValueError, TypeError, KeyError) as error:
        raise KinfeasError(f"{path}: no table of a benchmark; use another --out") from error
    if others := before - {(case.robot_name, case.task_name) for case in planned}:
        names = ", ".join(f"{robot} on {task}" for robot, task in sorted(others))
        raise KinfeasError(f"{path}: a table that also has {names}; use another --out")


def plan_evaluations(benchmark: BenchmarkConfig, runs: Sequence[TrainedRun]) -> list[Evaluation]:
    """Return the evaluations of a benchmark: ceiling and policies of each robot and task.

    The learned policies are those of the runs. A robot without runs has its shipped policy, if the
    benchmark takes it, else no learned policy.
    """
    names = {robot: load_robot(robot).name for robot in benchmark.robots}
    numbers = benchmark.episodes, benchmark.evaluation_seed
    ceilings = [
        Evaluation(robot, name, task, CEILING, CEILING, *numbers)
        for robot, name in names.items()
        for task in benchmark.tasks
    ]
    ceilings += [
        Evaluation(robot, names[robot], variant.task, CEILING, CEILING, *numbers,
            variant=variant.label, parameters=variant.parameters)
        for variant in benchmark.variants
        for robot in variant.robots
        if robot in names and variant.task in benchmark.tasks and benchmark.backend == "analytic"
    ]  # fmt: skip
    return [case for ceiling in ceilings for case in _of_policies(benchmark, runs, ceiling)]


def compute(case: Evaluation) -> Result:
    """Return the metrics of an evaluation, or the ceiling of its task."""
    robot = load_robot(case.robot)
    parameters = {f"task.{key}": value for key, value in case.parameters.items()}
    plan = configure(
        robot, case.task, case.backend, episodes=case.episodes, seed=case.seed,
        settings=nested(case.settings, parameters),
    )  # fmt: skip
    if case.policy == CEILING:
        numbers = plan.episodes, plan.seed, plan.world.ik
        bound = measure_reachability(robot, plan.task, *numbers).share
        return {"success": bound.value, "success_low": bound.low, "success_high": bound.high}
    policy = load_policy(case.source, robot)
    metrics = evaluate(replace(plan, first=case.first), policy, case.policy)
    return {key: value for key, value in metrics.items() if key not in _LEFT_OUT}


def _of_policies(
    benchmark: BenchmarkConfig, runs: Sequence[TrainedRun], case: Evaluation
) -> list[Evaluation]:
    """Return the ceiling `case`, and the evaluations of all policies on its robot and task."""
    base = replace(case, settings=benchmark.settings)
    robot_runs = [run for run in runs if run.robot == case.robot_name]
    learned = [replace(base, policy="sac", source=str(run.folder), training_seed=run.seed,
                       row=run.label)
               for run in robot_runs]  # fmt: skip
    if not robot_runs and takes_pretrained(benchmark, case.robot):
        learned = [replace(base, policy=PRETRAINED, source=PRETRAINED)]
    rows = []
    for row in benchmark.rows:
        if not case.variant and row.has(case.robot, case.task):
            settings = nested(benchmark.settings, row.settings, _filters(row.filters))
            rows += [
                replace(
                    learner,
                    row=", ".join(filter(None, [learner.row, row.label])),
                    settings=settings,
                )
                for learner in learned
            ]
    baselines = [_unplanned(benchmark, replace(base, policy=name, source=name))
                 for name, tasks in benchmark.baselines.items() if case.task in tasks]  # fmt: skip
    policies = [*learned, *rows, *baselines]
    if benchmark.backend == "analytic":
        return [base, *policies]
    parts = [
        replace(evaluation, backend=benchmark.backend, first=at,
                episodes=min(PART, case.episodes - at))
        for evaluation in policies
        for at in range(0, case.episodes, PART)
    ]  # fmt: skip
    bound = replace(case, settings=_task_parameters(benchmark.settings))
    return [bound, *(_without_physics(benchmark, evaluation) for evaluation in policies), *parts]


def _unplanned(benchmark: BenchmarkConfig, case: Evaluation) -> Evaluation:
    """Return an evaluation without the path planner, which would act in place of the policy."""
    used = read_settings(case.robot, benchmark.backend, case.settings).world.filters
    filters = tuple(spec for spec in used if spec.name != "path_planner")
    if filters == used:
        return case
    return replace(case, settings=nested(case.settings, _filters(filters)))


def _without_physics(benchmark: BenchmarkConfig, case: Evaluation) -> Evaluation:
    """Return an evaluation with the same filters in the analytic world, which has no obstacles."""
    used = read_settings(case.robot, benchmark.backend, case.settings).world.filters
    filters = tuple(spec for spec in used if spec.name != "obstacle_distance")
    return replace(case, settings=_task_parameters(case.settings) | _filters(filters))


def _task_parameters(settings: dict[str, object]) -> dict[str, object]:
    """Return the settings that change the episodes: the parameters of the task."""
    return {key: value for key, value in nested(settings).items() if key == "task"}


def _filters(filters: tuple[PluginSpec, ...] | None) -> dict[str, object]:
    """Return filters as a setting; no setting for None, which keeps the default."""
    return {} if filters is None else {"world.filters": config.to_mapping(filters)}


def _weights(case: Evaluation) -> str:
    """Return the hash of a learned policy, since it may be trained anew in the same folder."""
    if case.policy not in LEARNED_POLICIES:
        return ""
    folder = trained_folder(case.source, load_robot(case.robot))
    path = policy_folder(folder) / WEIGHTS
    with reading(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()


def read_run(folder: Path) -> TrainedRun:
    """Return the training run of a folder."""
    settings = read_training(folder)
    robot = load_robot(settings.robot).name
    return TrainedRun(folder, robot, settings.seed, task_name(settings.task))


def find_runs(folders: Sequence[Path]) -> list[TrainedRun]:
    """Return the runs in `folders` and one level below, in the order of robot and seed.

    If a robot has two runs with one seed, all its runs are labelled with their folders' names.
    """
    runs: dict[Path, TrainedRun] = {}
    for folder in folders:
        below = sorted(path.parent for path in folder.glob("*/config.yaml"))
        for path in [folder] if (folder / "config.yaml").is_file() or not below else below:
            runs[path] = read_run(path)
    seeds = Counter((run.robot, run.seed) for run in runs.values())
    several = {robot for (robot, _), count in seeds.items() if count > 1}
    unique: dict[tuple[str, int, str], TrainedRun] = {}
    for path, run in runs.items():
        label = path.name if run.robot in several else ""
        same = unique.setdefault((run.robot, run.seed, label), replace(run, label=label))
        if same.folder != path:
            raise KinfeasError(f"{same.folder} and {path}: both {run.robot} with seed {run.seed}")
    return [unique[key] for key in sorted(unique)]


def takes_pretrained(benchmark: BenchmarkConfig, robot: str) -> bool:
    """Return whether a benchmark takes the shipped policy of a robot."""
    if benchmark.policies == "train":
        return False
    return benchmark.policies == PRETRAINED or PRETRAINED in trained_policies(load_robot(robot))


def plan_runs(benchmark: BenchmarkConfig, out: Path) -> list[Job]:
    """Return the training runs of a benchmark."""
    if benchmark.policies == PRETRAINED:
        return []
    robots = [robot for robot in benchmark.robots if not takes_pretrained(benchmark, robot)]
    for robot in robots:
        if robot not in {training.robot for training in benchmark.trainings}:
            raise KinfeasError(f"'trainings' has no entry for {robot}")
    plans = {}
    for training in benchmark.trainings:
        for seed in benchmark.seeds if training.robot in robots else ():
            settings = _training(training, seed)
            name = f"{load_robot(settings.robot).name}-{seed}"
            if name in plans:
                raise KinfeasError(f"'trainings' has two runs {name}")
            plans[name] = training_job(settings, out / "runs" / name)
    return list(plans.values())


def publish(runs: Sequence[TrainedRun], folder: Path) -> list[Path]:
    """Copy the best policy of each robot into `folder/ROBOT` and return these folders.

    The best policy has the highest success in the evaluation that selected its checkpoint.
    """
    best: dict[str, tuple[TrainedRun, Trained]] = {}
    for run in runs:
        trained = read_best(run.folder)
        success = trained.evaluation["success"]
        if run.robot not in best or success > best[run.robot][1].evaluation["success"]:
            best[run.robot] = run, trained
    for robot, (run, trained) in best.items():
        about = replace(trained, seed=run.seed, version=__version__)
        copy_network(policy_folder(run.folder), about, folder / robot)
    return [folder / robot for robot in best]


def _training(training: Training, seed: int) -> TrainConfig:
    values = {"robot": training.robot, "seed": seed}
    limits = duration(training.minutes, training.steps)
    settings = config.nested(values, limits, training.settings)
    return with_initial_policy(load_recipe(training.recipe, settings), training.settings)
