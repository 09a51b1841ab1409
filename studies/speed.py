"""Print run times of inverse kinematics, environments, a policy and training on this machine.

    python studies/speed.py --robot hsr

IK is timed beside Pinocchio and PyBullet. Figures are the best of several repeats on one core.
Training uses the robot's recipe on all cores for half a minute.
`time_to_level.py` trains whole recipes.
"""

import argparse
import itertools
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import ik_peers as peers
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.config.recipes import load_section
from kinfeas.control.observation import HORIZON
from kinfeas.core import spatial
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.planning.base_path import BasePathPlanner
from kinfeas.policies.baselines.following import FollowBase, FollowEe
from kinfeas.policies.loading import trained_folder
from kinfeas.policies.network import read_network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task

BATCHES = {1: 1500, 128: 300, 1024: 100}
"""Robots side by side, and the timed steps."""

MOTIONS = 100
"""Motions of `ggr` that are planned."""

ROOM_STEPS = 800
"""Timed steps among solids: more than an episode, so that its start counts, too."""

TIMED, REPEATS = 2000, 5
"""IK targets of each kind, also the number of actions; and repetitions of a measurement."""

TRAIN_MINUTES = 0.5
"""Length of a training."""

METRES, RADIANS = 1e-4, 1e-3
"""Tolerances of an IK solution."""

_EE_STEP, _EE_TURN, _BASE_STEP = 0.01, 0.01, 0.02
"""Largest motions in one step of the loop: of the EE, metres and radians, and of the base."""


@dataclass(frozen=True)
class Figure:
    """One measurement: its name, its value and the unit (none for fractions).

    The value is None if the peer is not installed.
    """

    text: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class Targets:
    """IK targets: EE poses in the base frame, shape (n, 7), and seeds, shape (n, j)."""

    pose: Array
    seed: Array


@dataclass(frozen=True)
class IkTiming:
    """Microseconds per target, and the fraction of targets with a valid solution, 0-1."""

    microseconds: float
    solved: float


def measure_ik(robot: Robot) -> Iterator[Figure]:
    """Yield time and solved fraction of inverse kinematics, for our solver and its peers."""
    rng = np.random.default_rng(0)
    others = {"Pinocchio": peers.pinocchio_peer(robot), "PyBullet": peers.pybullet_peer(robot)}
    with one_core():
        warm = warm_targets(robot, TIMED, rng)
        cold = cold_targets(robot, TIMED, rng)
        for kind, targets in (("warm", warm), ("cold", cold)):
            free = time_ours(robot, targets, self_collision=False)
            full = time_ours(robot, targets, self_collision=True)
            yield from _figures(f"IK {kind}, self-collision off", free)
            yield from _figures(f"IK {kind}", full)
            for name, peer in others.items():
                timing = None if peer is None else time_peer(robot, peer, targets)
                yield from _figures(f"{name} {kind}", timing)


def measure_plans(robot: Robot) -> Iterator[Figure]:
    """Yield the time of plans of base and arm along whole motions of `ggr`, and how many exist."""
    world = World(robot, load_task("ggr"), WorldConfig(), seed=0)
    planner, seconds, found = BasePathPlanner(IkSolver(robot)), [], []
    world.start(range(MOTIONS))
    robots = world.loop.robots
    paths = world.loop.sequence.to_the_end(np.arange(MOTIONS))
    with one_core():
        for base, joints, ee in zip(robots.base_pose, robots.joint_positions, paths, strict=True):
            start = time.perf_counter()
            found.append(planner.plan(base, joints, ee, HORIZON, 0.0) is not None)
            seconds.append(time.perf_counter() - start)
    yield Figure("motion, median", float(np.median([len(ee) for ee in paths])) * HORIZON, "s")
    for name, times in (("plan", seconds), ("plan that is found", np.array(seconds)[found])):
        for quantile, level in (("median", 0.5), ("p90", 0.9), ("p99", 0.99)):
            yield Figure(f"{name}, {quantile}", float(np.quantile(times, level)), "s")
    yield Figure("plans found", float(np.mean(found)), "")


def measure_environments(robot: Robot) -> Iterator[Figure]:
    """Yield environment steps per second of bases that follow the EE, with self-collision."""
    with one_core():
        for batch, steps in BATCHES.items():
            world = World(robot, load_task("ggr"), WorldConfig(), seed=0)
            rate = environment_rate(world, FollowEe(robot.base), batch, steps)
            yield Figure(f"environment, batch {batch}", rate, "steps/s")


def measure_rooms(robot: str) -> Iterator[Figure]:
    """Yield environment steps per second in the recipe for rooms, among 32 solids."""
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.worlds import training_world

    model, settings = load_robot(robot), {"robot": robot, "task_parameters.places": 32}
    recipe = load_section(TrainConfig, "train_rooms", model.folder, settings)
    policy = FollowBase(model.base, source="planned_base")
    with one_core():
        batch = recipe.num_envs
        rate = environment_rate(training_world(recipe), policy, batch, ROOM_STEPS)
    yield Figure(f"environment among 32 solids, batch {batch}", rate, "steps/s")


def environment_rate(world: World, policy: Policy, batch: int, steps: int) -> float:
    """Return environment steps per second, including the policy and restarts.

    `batch` robots move side by side for `steps` control periods; the fastest repetition counts.
    """
    rates = []
    for _ in range(REPEATS):
        world.next_episode = 0
        world.start_next(batch)
        rates.append(batch * steps / best_of(1, lambda: _drive(world, policy, steps), 0.0))
    return max(rates)


def measure_action(robot: Robot) -> Iterator[Figure]:
    """Yield the time of the packaged policy from one observation to its action."""
    network = read_network(trained_folder("pretrained", robot), robot)
    observation = np.random.default_rng(0).normal(size=(1, len(network.scale)))

    def act() -> None:
        for _ in range(TIMED):
            network(observation)

    act()
    with one_core():
        seconds = best_of(REPEATS, act)
    yield Figure("action of a policy", seconds / TIMED * 1e6, "us")


def measure_training(robot: str) -> Iterator[Figure]:
    """Yield speed and fractions of time of a short training run by the robot's own recipe.

    A step is a control period of one environment. Fractions are of the time of all steps;
    the environments are stepped in a thread beside the updates.
    """
    # Not at the top: they load torch.
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.train import train

    few = ("evaluations", "evaluation_episodes", "final_episodes")
    schedule = {"minutes": TRAIN_MINUTES, **dict.fromkeys(few, 1)}
    settings = {"robot": robot, "schedule": schedule}
    with tempfile.TemporaryDirectory() as folder:
        recipe = load_section(TrainConfig, "train", robot, settings)
        progress = train(recipe, Path(folder) / "run")
    steps, seconds = progress.steps, progress.parts["step"]
    yield Figure("training", steps / progress.seconds, "steps/s")
    for part, text in (("update", "updates"), ("waiting", "waiting for environments")):
        yield Figure(f"share of {text}", progress.parts[part] / seconds, "")


def cold_targets(robot: Robot, count: int, rng: np.random.Generator) -> Targets:
    """Return the EE poses of random configurations, each with an unrelated random seed."""
    solver = IkSolver(robot)
    goal, seed = (_free_configurations(solver, count, rng) for _ in range(2))
    return Targets(forward(solver.chain, goal), seed)


def warm_targets(robot: Robot, count: int, rng: np.random.Generator) -> Targets:
    """Return EE poses one step of the loop away from the seeds.

    The EE moves by 1 cm and 0.01 rad, the base by up to 2 cm, all in random directions. Infeasible
    steps are left out. With pose tolerance the target is the pose of the solution, since too few
    joints follow a step exactly.
    """
    solver, poses, seeds, found = IkSolver(robot), [], [], 0
    while found < count:
        seed = _free_configurations(solver, count, rng)
        solution = solver.solve(_one_step(forward(solver.chain, seed), rng), seed)
        moved = solution.feasible & np.any(solution.joint_positions != seed, axis=1)
        poses.append(forward(solver.chain, solution.joint_positions[moved]))
        seeds.append(seed[moved])
        found += len(seeds[-1])
    return Targets(np.concatenate(poses)[:count], np.concatenate(seeds)[:count])


def time_ours(robot: Robot, targets: Targets, self_collision: bool) -> IkTiming:
    """Return the timing of our solver, without pose tolerance."""
    solver = IkSolver(robot, IkOptions(self_collision=self_collision, pose_tolerance=False))
    solution = solver.solve(targets.pose, targets.seed)
    seconds = best_of(REPEATS, lambda: solver.solve(targets.pose, targets.seed))
    good = solution.feasible & _verified(solver, targets, solution.joint_positions)
    return IkTiming(seconds / len(good) * 1e6, float(good.mean()))


def time_peer(robot: Robot, peer: peers.Peer, targets: Targets) -> IkTiming:
    """Return the timing of a peer; our own kinematics verifies its solutions."""
    problems = [peer.prepare(pose) for pose in targets.pose]
    seeds = list(targets.seed)

    def solve() -> list[Array]:
        return [peer.solve(problem, seed) for problem, seed in zip(problems, seeds, strict=True)]

    joints = np.array(solve())
    seconds = best_of(2, solve)
    good = _verified(IkSolver(robot), targets, joints)
    return IkTiming(seconds / len(good) * 1e6, float(good.mean()))


def best_of(repeats: int, work: Callable[[], object], at_least: float = 0.3) -> float:
    """Return the seconds of the fastest of several runs of `work`.

    There are at least `repeats` runs, which take `at_least` seconds together.
    """
    seconds: list[float] = []
    while len(seconds) < repeats or sum(seconds) < at_least:
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on a single core, where the system supports it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _figures(text: str, timing: IkTiming | None) -> Iterator[Figure]:
    yield Figure(text, timing.microseconds if timing else None, "us")
    if timing is not None:
        yield Figure(f"{text}, solved", timing.solved, "")


def _drive(world: World, policy: Policy, steps: int) -> None:
    for _ in range(steps):
        transition = world.step(policy.act(world.loop.observation))
        ended = np.flatnonzero(transition.done)
        if ended.size:
            world.start_next(ended.size, ended)


def _verified(solver: IkSolver, targets: Targets, joints: Array) -> NDArray[np.bool_]:
    metres, radians = spatial.distance(forward(solver.chain, joints), targets.pose)
    lower, upper = solver.robot.joint_limits
    within: NDArray[np.bool_] = np.all((joints >= lower - 1e-9) & (joints <= upper + 1e-9), axis=1)
    return within & (metres <= METRES) & (radians <= RADIANS)


def _free_configurations(solver: IkSolver, count: int, rng: np.random.Generator) -> Array:
    """Return random configurations free of self-collision, shape (count, j)."""
    lower, upper = solver.robot.finite_joint_limits
    kept = np.empty((0, len(lower)))
    while len(kept) < count:
        joints = rng.uniform(lower, upper, (count, len(lower)))
        kept = np.concatenate([kept, joints[~self_collides(solver.collision, joints)]])
    return kept[:count]


def _one_step(ee_pose: Array, rng: np.random.Generator) -> Array:
    """Return EE poses after a step, in the frame of the moved base, shape (n, 7)."""
    count = len(ee_pose)
    moved = ee_pose[:, :3] + _EE_STEP * _directions(rng, count, 3)
    moved[:, :2] -= rng.uniform(0.0, _BASE_STEP, (count, 1)) * _directions(rng, count, 2)
    turn = Rotation.from_rotvec(_EE_TURN * _directions(rng, count, 3))
    return spatial.make_pose(moved, turn * spatial.rotation(ee_pose))


def _directions(rng: np.random.Generator, count: int, axes: int) -> Array:
    vectors = rng.normal(size=(count, axes))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _peak_memory_mb() -> float:
    """Return the peak memory of this process and its children so far, 10^6 bytes."""
    processes = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    most = max(resource.getrusage(who).ru_maxrss for who in processes)
    # Linux counts kibibytes, macOS bytes.
    return most / 1e6 if sys.platform == "darwin" else most * 1024 / 1e6


def main() -> None:
    """Print all figures of a robot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--robot", default="pr2")
    name = parser.parse_args().robot
    robot = load_robot(name)
    figures = itertools.chain(
        measure_ik(robot), measure_environments(robot), measure_rooms(name), measure_plans(robot),
        measure_action(robot), measure_training(name),
    )  # fmt: skip
    for figure in figures:
        print(f"{figure.text:42s} {_text(figure)}", flush=True)
    print(f"{'peak memory':42s} {_peak_memory_mb():,.0f} MB")


def _text(figure: Figure) -> str:
    if figure.value is None:
        return "not installed"
    if not figure.unit:
        return f"{100.0 * figure.value:.1f} %"
    return f"{figure.value:,.{0 if figure.value >= 1000 else 2}f} {figure.unit}"


if __name__ == "__main__":
    main()
