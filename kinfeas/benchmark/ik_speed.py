"""How fast inverse kinematics is, ours and that of others, on the same targets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.benchmark.peers import Peer
from kinfeas.benchmark.timing import best_of
from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.robot import Robot

METRES, RADIANS = 1e-4, 1e-3
"""How near to its target a solution has to be."""

_EE_STEP, _EE_TURN, _BASE_STEP = 0.01, 0.01, 0.02
"""What moves in one step of the loop at most: the EE, metres and radians, and the base, metres."""


@dataclass(frozen=True)
class Targets:
    """n problems of inverse kinematics.

    Attributes:
        pose: EE poses in the base frame, shape (n, 7).
        seed: Where the arm is, shape (n, v).
    """

    pose: Array
    seed: Array


@dataclass(frozen=True)
class IkTiming:
    """What a solver needs and what it finds.

    Attributes:
        microseconds: Per target, found or not.
        solved: Share of targets with a solution that is exact and within the limits, 0-1.
    """

    microseconds: float
    solved: float


def cold_targets(robot: Robot, count: int, rng: np.random.Generator) -> Targets:
    """Return poses of random configurations, each with an unrelated random seed."""
    solver = IkSolver(robot)
    goal, seed = (_free_configurations(solver, count, rng) for _ in range(2))
    return Targets(forward(solver.chain, goal), seed)


def warm_targets(robot: Robot, count: int, rng: np.random.Generator) -> Targets:
    """Return poses one step of the loop away from where the arm is.

    The EE moves by 1 cm and 0.01 rad, the base under it by up to 2 cm, all in random directions.
    Steps that no configuration follows are left out; a robot with pose tolerance, whose joints are
    too few to follow any step exactly, gets the pose that it comes to, unless that is where it is.
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


def time_ours(robot: Robot, targets: Targets, self_collision: bool, repeats: int = 5) -> IkTiming:
    """Return the timing of our solver on `targets`, without pose tolerance."""
    solver = IkSolver(robot, IkOptions(self_collision=self_collision, pose_tolerance=False))
    solution = solver.solve(targets.pose, targets.seed)
    seconds = best_of(repeats, lambda: solver.solve(targets.pose, targets.seed))
    good = solution.feasible & _verified(solver, targets, solution.joint_positions)
    return IkTiming(seconds / len(good) * 1e6, float(good.mean()))


def time_peer(robot: Robot, peer: Peer, targets: Targets, repeats: int = 2) -> IkTiming:
    """Return what another solver makes of `targets`; our own kinematics checks its solutions."""
    problems = [peer.prepare(pose) for pose in targets.pose]
    seeds = list(targets.seed)

    def solve() -> list[Array]:
        return [peer.solve(problem, seed) for problem, seed in zip(problems, seeds, strict=True)]

    joints = np.array(solve())
    seconds = best_of(repeats, solve)
    good = _verified(IkSolver(robot), targets, joints)
    return IkTiming(seconds / len(good) * 1e6, float(good.mean()))


def _verified(solver: IkSolver, targets: Targets, joints: Array) -> NDArray[np.bool_]:
    metres, radians = spatial.distance(forward(solver.chain, joints), targets.pose)
    lower, upper = solver.robot.joint_limits
    within: NDArray[np.bool_] = np.all((joints >= lower - 1e-9) & (joints <= upper + 1e-9), axis=1)
    return within & (metres <= METRES) & (radians <= RADIANS)


def _free_configurations(solver: IkSolver, count: int, rng: np.random.Generator) -> Array:
    """Return random configurations free of self-collision, shape (count, v)."""
    lower, upper = solver.robot.finite_joint_limits
    kept = np.empty((0, len(lower)))
    while len(kept) < count:
        joints = rng.uniform(lower, upper, (count, len(lower)))
        kept = np.concatenate([kept, joints[~self_collides(solver.collision, joints)]])
    return kept[:count]


def _one_step(ee_pose: Array, rng: np.random.Generator) -> Array:
    """Return the poses, shape (n, 7), that the EE has to come to in the base frame."""
    count = len(ee_pose)
    moved = ee_pose[:, :3] + _EE_STEP * _directions(rng, count, 3)
    moved[:, :2] -= rng.uniform(0.0, _BASE_STEP, (count, 1)) * _directions(rng, count, 2)
    turn = Rotation.from_rotvec(_EE_TURN * _directions(rng, count, 3))
    return spatial.make_pose(moved, turn * spatial.rotation(ee_pose))


def _directions(rng: np.random.Generator, count: int, axes: int) -> Array:
    vectors = rng.normal(size=(count, axes))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
