"""The cells of a benchmark: each computed once, written at once, and found again after a stop."""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas import __version__, config, registry
from kinfeas.envs.world import World, WorldConfig
from kinfeas.errors import KinfeasError
from kinfeas.evaluation.benchmark.samples import WorkspaceSamples
from kinfeas.evaluation.ceiling import measure_ceiling
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.evaluation.evaluate import worker_pool
from kinfeas.evaluation.physics.evaluate import is_judged, physics_figures, run_part
from kinfeas.evaluation.physics.world import PhysicsSettings, PhysicsTrial, to_lists
from kinfeas.evaluation.policies import BASELINES, LOOK_AHEAD, load_driver, load_policy
from kinfeas.look_ahead import Foresight
from kinfeas.metrics import summarize
from kinfeas.policy import Network
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.sim.stage import task_scene
from kinfeas.storage.files import is_path, reading, write_file, writing
from kinfeas.tasks.loading import load_task, task_name
from kinfeas.tasks.task import Task

_FORMAT = 1
"""Of the files; whoever changes what stands in them or how it is found counts it up."""

Result = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Job:
    """One figure to find: a policy on a task, or the task's ceiling.

    Attributes:
        robot: Name or YAML file.
        task: Name or YAML file.
        parameters: Its keyword parameters.
        variant: What is different about them.
        policy: What the policy is called in the table; `ceiling` for the ceiling.
        source: What `load_driver` takes.
        training_seed: Seed that it was trained with, if it was and that is known.
        episodes: How many.
        seed: Of the episodes.
        world: Where they happen.
        first: Number of the first episode; of physics alone, whose episodes come in parts.
    """

    robot: str
    task: str
    parameters: dict[str, object]
    variant: str
    policy: str
    source: str
    training_seed: int | None
    episodes: int
    seed: int
    world: WorldConfig | PhysicsSettings
    first: int = 0

    @property
    def physical(self) -> bool:
        """Whether it happens in the PyBullet world."""
        return isinstance(self.world, PhysicsSettings)

    @property
    def task_name(self) -> str:
        """What its task is called in tables."""
        return task_name(self.task)

    @property
    def name(self) -> str:
        """What it is called in errors and as a file."""
        seed = "" if self.training_seed is None else f"-{self.training_seed}"
        variant = "" if not self.variant else "-variant"
        part = f"-pybullet-{self.first}" if self.physical else ""
        policy = self.policy.replace(":", "-")
        return f"{Path(self.robot).stem}-{self.task_name}{variant}-{policy}{seed}{part}"


CEILING = "ceiling"


def identity(job: Job) -> dict[str, Any]:
    """Return everything that determines what a job finds, as plain data.

    Raises:
        KinfeasError: If its robot, its task or its policy cannot be read.
    """
    robot = registry.load_robot(job.robot)
    return {
        "format": _FORMAT,
        "version": __version__,
        "robot": robot.name,
        "robot_digest": _robot_digest(robot),
        "task": job.task_name,
        "parameters": job.parameters,
        "policy": _policy_digest(job, robot),
        "episodes": job.episodes,
        "seed": job.seed,
        "world": config.to_mapping(job.world),
        **({"task_digest": _file_digest(Path(job.task))} if is_path(job.task) else {}),
        **(_physical_identity(job) if job.physical else {}),
    }


def run_jobs(
    jobs: Sequence[Job],
    folder: Path,
    processes: int = 1,
    on_done: Callable[[Job], None] | None = None,
) -> list[Result]:
    """Return what each job found; those found before are read from `folder`.

    Args:
        jobs: What to find.
        folder: Where results are kept, each written as soon as it is there.
        processes: How many processes share the work; no result depends on it.
        on_done: Called with each job that is done.

    Raises:
        KinfeasError: If a job's input is wrong, a result cannot be written or a worker dies.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    whole = _identities(jobs)
    paths = [folder / f"{job.name}-{_key(one)}.json" for job, one in zip(jobs, whole, strict=True)]
    found: list[Result | None] = [
        _stored(path, one) for path, one in zip(paths, whole, strict=True)
    ]

    def keep(index: int, result: Result) -> None:
        _write(paths[index], {"identity": whole[index], **result})
        found[index] = result
        if on_done is not None:
            on_done(jobs[index])

    missing = [index for index, result in enumerate(found) if result is None]
    if on_done is not None:
        for index in sorted(set(range(len(jobs))) - set(missing)):
            on_done(jobs[index])
    if processes == 1 or len(missing) < 2:
        for index in missing:
            keep(index, compute(jobs[index]))
    else:
        with worker_pool(min(processes, len(missing))) as pool:
            futures = {pool.submit(compute, jobs[index]): index for index in missing}
            for future in as_completed(futures):
                keep(futures[future], future.result())
    return [result for result in found if result is not None]


def compute(job: Job) -> Result:
    """Return what a job finds: its figures, and for a learned policy samples of the workspace."""
    robot, task = registry.load_robot(job.robot), load_task(job.task, job.parameters)
    if isinstance(job.world, PhysicsSettings):
        return _compute_part(job, robot, task, job.world)
    if job.policy == CEILING:
        ceiling = measure_ceiling(robot, task, job.episodes, job.seed, job.world.ik)
        share = ceiling.share
        return {"figures": {"success": share.value, "low": share.low, "high": share.high}}
    policy = load_driver(job.source, robot)
    world = World(robot, task, job.world, job.seed)
    samples = WorkspaceSamples() if isinstance(policy, Network) else None
    records = run_episodes(world, policy, job.episodes, watch=samples)
    result: Result = {"figures": summarize(records)}
    return result if samples is None else {**result, "workspace": samples.kept()}


def _compute_part(job: Job, robot: Robot, task: Task, settings: PhysicsSettings) -> Result:
    """Return what happened in each episode of a part, and what these alone come to."""
    trial = PhysicsTrial(robot, task, job.episodes, job.seed, settings)
    episodes = range(job.first, job.first + job.episodes)
    records = run_part(trial, load_driver(job.source, robot), episodes)
    figures = physics_figures(records, judged=is_judged(trial))
    return {"figures": figures, "records": to_lists(records)}


def _identities(jobs: Sequence[Job]) -> list[dict[str, Any]]:
    """Return the identities of jobs; robot, scene and policy are read once for parts of a cell."""
    known: dict[tuple[object, ...], dict[str, Any]] = {}
    found = []
    for job in jobs:
        if not job.physical:
            found.append(identity(job))
            continue
        told = json.dumps([job.parameters, config.to_mapping(job.world)])
        cell = (job.robot, job.task, job.policy, job.source, job.seed, told)
        if cell not in known:
            known[cell] = identity(job)
        found.append({**known[cell], "episodes": job.episodes, "first": job.first})
    return found


def _physical_identity(job: Job) -> dict[str, Any]:
    scene = task_scene(load_task(job.task, job.parameters))
    return {"first": job.first, "scene": "" if scene is None else _scene_digest(scene)}


def _file_digest(path: Path) -> str:
    with reading(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()


def _scene_digest(scene: Scene) -> str:
    digest = hashlib.sha256()
    for name, one in scene.objects.items():
        told = {"name": name, "pose": one.pose.tolist(), "joints": one.joint_positions}
        digest.update(json.dumps([told, one.fixed]).encode() + one.urdf_path.read_bytes())
    return digest.hexdigest()


def _stored(path: Path, wanted: dict[str, Any]) -> Result | None:
    """Return the result that a file holds, or None if there is none of this identity."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        same = held.pop("identity") == json.loads(json.dumps(wanted))
        return held if same and "figures" in held else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise KinfeasError(f"{path}: broken; remove it to have it computed again") from error


def _write(path: Path, result: Result) -> None:
    write_file(path, json.dumps(result, allow_nan=False).encode())


def _key(whole: dict[str, Any]) -> str:
    text = json.dumps(whole, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _policy_digest(job: Job, robot: Robot) -> str:
    if job.policy == CEILING or job.source in BASELINES:
        return job.source
    network = load_policy(job.source.removeprefix(LOOK_AHEAD), robot)
    assert isinstance(network, Network)
    digest = hashlib.sha256()
    if job.source.startswith(LOOK_AHEAD):
        digest.update(repr(Foresight()).encode())
    for values in (network.scale, *network.weights, *network.biases):
        digest.update(f"{values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _robot_digest(robot: Robot) -> str:
    """Return what tells two versions of a robot apart: all that its YAML and its URDF say."""
    told = {
        entry.name: getattr(robot, entry.name)
        for entry in fields(robot)
        if entry.name not in ("urdf", "urdf_path")
    }
    text = json.dumps(told, default=_plain, sort_keys=True)
    return hashlib.sha256(robot.urdf_path.read_bytes() + text.encode()).hexdigest()


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, frozenset):
        return sorted((_plain(entry) for entry in value), key=str)
    if is_dataclass(value) and not isinstance(value, type):
        return {entry.name: getattr(value, entry.name) for entry in fields(value)}
    return value
