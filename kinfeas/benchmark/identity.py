"""What tells the cells of a benchmark apart: all that determines a figure, as plain data."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas import __version__, config
from kinfeas.backends.pybullet.stage import task_scene
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.io.files import is_path, reading
from kinfeas.policies.loading import BASELINES, load_policy
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import Task

_FORMAT = 1
"""Of the files; whoever changes what stands in them or how it is found counts it up."""

_RULES = 2
"""By which collisions and tasks done are told in the PyBullet world, counted up as they change."""

_LATER: tuple[tuple[str, list[object]], ...] = (("filters", []),)
"""Settings of the world that came after the first cells, with the value that changes nothing: left
out, so that these cells are found."""


def identity(job: Job) -> dict[str, Any]:
    """Return everything that determines what a job finds, as plain data.

    Raises:
        KinfeasError: If its robot, its task or its policy cannot be read.
    """
    robot = load_robot(job.robot)
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
        "world": _world(job),
        **({"task_digest": _file_digest(Path(job.task))} if is_path(job.task) else {}),
        **_motion_files(load_task(job.task, job.parameters)),
        **(_physical_identity(job) if job.physical else {}),
    }


def _world(job: Job) -> dict[str, Any]:
    told = config.to_mapping(job.world)
    return {key: value for key, value in told.items() if (key, value) not in _LATER}


def identities(jobs: Sequence[Job]) -> list[dict[str, Any]]:
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
    digest = "" if scene is None else _scene_digest(scene)
    return {"first": job.first, "scene": digest, "rules": _RULES}


def _motion_files(task: Task) -> dict[str, Any]:
    """Return the digests of the models, waypoints and the like that a task's motions name."""
    digests = [
        _file_digest(path)
        for subgoal in task.subgoals
        for path in _files(subgoal.motion.parameters.values())
    ]
    return {"motion_digests": digests} if digests else {}


def _files(values: Iterable[object]) -> Iterator[Path]:
    """Yield the files that parameters name, however deep within them."""
    for value in values:
        if isinstance(value, Mapping):
            yield from _files(value.values())
        elif isinstance(value, list | tuple):
            yield from _files(value)
        elif isinstance(value, str | Path) and _is_file(value):
            yield Path(value)


def _is_file(name: str | Path) -> bool:
    # Path.is_file raises if a name is too long; what has no suffix is no name of a file.
    return bool(Path(name).suffix) and os.path.isfile(name)  # noqa: PTH113


def _file_digest(path: Path) -> str:
    with reading(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()


def _scene_digest(scene: Scene) -> str:
    digest = hashlib.sha256()
    for name, one in scene.objects.items():
        told = {"name": name, "pose": one.pose.tolist(), "joints": one.joint_positions}
        digest.update(json.dumps([told, one.fixed]).encode() + one.urdf_path.read_bytes())
    return digest.hexdigest()


def _policy_digest(job: Job, robot: Robot) -> str:
    if job.policy == CEILING or job.source in BASELINES:
        return job.source
    network = load_policy(job.source, robot)
    assert isinstance(network, Network)
    digest = hashlib.sha256()
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
