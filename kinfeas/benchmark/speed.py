"""How fast everything is, measured in one run on one machine."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinfeas.benchmark import peers
from kinfeas.benchmark.ik_speed import (
    IkTiming,
    Targets,
    cold_targets,
    time_ours,
    time_peer,
    warm_targets,
)
from kinfeas.benchmark.timing import best_of, one_core, peak_memory_mb
from kinfeas.control import drive, observation
from kinfeas.core import registry
from kinfeas.core.policy import Policy
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot

BATCHES = {1: 1500, 128: 300, 1024: 100}
"""Robots side by side, and the steps that they are timed over."""


@dataclass(frozen=True)
class Figure:
    """One thing that was measured.

    Attributes:
        text: What it is.
        value: The number; None if there was nothing to measure.
        unit: Of the number; empty for a share in 0-1.
        key: Its key in machine-readable output, if it has one.
    """

    text: str
    value: float | None
    unit: str
    key: str = ""


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        targets: Problems of inverse kinematics of each kind.
        repeats: Runs of each, of which the quickest counts.
        train_minutes: Length of the training run.
    """

    targets: int = 2000
    repeats: int = 5
    train_minutes: float = 0.5


def measure_speed(
    robot: str,
    network: Network | None = None,
    effort: Effort | None = None,
    on_part: Callable[[str], None] | None = None,
) -> list[Figure]:
    """Return how fast everything is: all on one core but training, which takes all there are.

    Args:
        robot: Name of a robot or path of its YAML.
        network: Policy whose latency is measured; by default one of 256 x 256 random weights.
        effort: How much is measured.
        on_part: Called with the name of each part when it begins.
    """
    effort, known = effort or Effort(), load_robot(robot)
    network = network or random_network(known)
    parts: dict[str, Callable[[], Iterator[Figure]]] = {
        "inverse kinematics": lambda: measure_ik(known, effort),
        "environment": lambda: measure_environments(known, effort),
        "action": lambda: measure_action(known, network, effort),
        "training": lambda: measure_training(robot, effort),
    }
    figures: list[Figure] = []
    for name, measure in parts.items():
        if on_part is not None:
            on_part(name)
        figures += measure()
    return [*figures, Figure("peak memory of all this", peak_memory_mb(), "MB", "peak_rss_mb")]


def measure_ik(robot: Robot, effort: Effort) -> Iterator[Figure]:
    """Yield the time and the yield of inverse kinematics, ours and that of others."""
    rng = np.random.default_rng(0)
    others = {"Pinocchio": peers.pinocchio_peer(robot), "PyBullet": peers.pybullet_peer(robot)}
    with one_core():
        warm = warm_targets(robot, effort.targets, rng)
        cold = cold_targets(robot, effort.targets, rng)
        for kind, targets in (("warm", warm), ("cold", cold)):
            free = time_ours(robot, targets, self_collision=False, repeats=effort.repeats)
            full = time_ours(robot, targets, self_collision=True, repeats=effort.repeats)
            is_cold = kind == "cold"
            yield from _timing(f"IK {kind}, self-collision off", free, "" if is_cold else "ik_warm")
            yield from _timing(f"IK {kind}", full, "ik_cold" if is_cold else "")
            for name, peer in others.items():
                yield from _peer_timing(f"{name} {kind}", peer, robot, targets)


def measure_environments(robot: Robot, effort: Effort) -> Iterator[Figure]:
    """Yield the steps a second of environments that follow the EE, self-collision on."""
    with one_core():
        for batch, steps in BATCHES.items():
            rate = environment_rate(robot, FollowEe(robot.base), batch, steps, effort.repeats)
            text = f"environment, batch {batch}"
            yield Figure(text, rate, "steps/s", f"env_steps_per_s_{batch}")


def environment_rate(
    robot: Robot, policy: Policy, batch: int, steps: int, repeats: int = 3
) -> float:
    """Return environment steps a second, policy and restarts of ended episodes included.

    Args:
        robot: Who moves.
        policy: Moves the base.
        batch: Robots side by side.
        steps: Control periods to time.
        repeats: Equal runs, of which the quickest counts.
    """
    world = World(robot, registry.build("kinfeas.tasks", "ggr", {}), WorldConfig(), seed=0)
    rates = []
    for _ in range(repeats):
        world.start(range(batch))
        rates.append(batch * steps / best_of(1, lambda: _drive(world, policy, steps), 0.0))
    return max(rates)


def measure_action(robot: Robot, network: Network, effort: Effort) -> Iterator[Figure]:
    """Yield how long a policy takes from one observation to its action."""
    seen = np.random.default_rng(0).normal(size=(1, len(network.scale)))

    def act() -> None:
        for _ in range(effort.targets):
            network(seen)

    act()
    with one_core():
        seconds = best_of(effort.repeats, act)
    yield Figure("action of a policy", seconds / effort.targets * 1e6, "us", "action_us")


def measure_training(robot: str, effort: Effort) -> Iterator[Figure]:
    """Yield the steps a second of a short training run by the robot's own recipe.

    A step is a control period of one environment: an action that holds for two counts twice. The
    evaluation at the end and checkpoints are included.
    """
    # Not at the top, for they load torch.
    from kinfeas.benchmark.study import Training
    from kinfeas.benchmark.trainings import settings_of
    from kinfeas.training.train import train

    recipe = Training(robot, minutes=effort.train_minutes, settings=("schedule.evaluations=1",))
    config = settings_of(recipe, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        progress = train(config, Path(folder) / "run")
    rate = progress.steps / progress.seconds
    yield Figure("training, all cores, end to end", rate, "steps/s", "train_steps_per_s")


def random_network(robot: Robot, width: int = 256) -> Network:
    """Return an untrained network of two hidden layers that fits `robot`."""
    rng = np.random.default_rng(0)
    sizes = (observation.size(robot), width, width, drive.action_size(robot.base))
    return Network(
        scale=observation.scale(robot).astype(np.float32),
        weights=tuple(
            rng.normal(0.0, (2.0 / rows) ** 0.5, (rows, columns)).astype(np.float32)
            for rows, columns in pairwise(sizes)
        ),
        biases=tuple(np.zeros(columns, dtype=np.float32) for columns in sizes[1:]),
    )


def _timing(text: str, timing: IkTiming, key: str) -> Iterator[Figure]:
    yield Figure(text, timing.microseconds, "us", f"{key}_us" if key else "")
    yield Figure(f"{text}, solved", timing.solved, "", "ik_cold_solved" if key == "ik_cold" else "")


def _peer_timing(
    text: str, peer: peers.Peer | None, robot: Robot, targets: Targets
) -> Iterator[Figure]:
    # PyBullet finds next to nothing from afar: how long it takes over that is of no use to anyone.
    key = "" if text == "PyBullet cold" else f"{text.lower().replace(' ', '_')}_us"
    if peer is None:
        yield Figure(text, None, "us", key)
        return
    timing = time_peer(robot, peer, targets)
    yield Figure(text, timing.microseconds, "us", key)
    yield Figure(f"{text}, solved", timing.solved, "")


def _drive(world: World, policy: Policy, steps: int) -> None:
    for _ in range(steps):
        transition = world.step(policy.act(world.loop.policy_input))
        ended = np.flatnonzero(transition.done)
        if ended.size:
            world.start(range(len(transition.done), len(transition.done) + ended.size), ended)
