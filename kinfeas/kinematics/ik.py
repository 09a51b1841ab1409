"""Inverse kinematics that the reward can stand on: verified, within limits, deterministic."""

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import Interval
from kinfeas.config.quantities import Positive, Share
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.kinematics.descent import Descent
from kinfeas.kinematics.forward import Chain, build_chain, forward
from kinfeas.kinematics.search import Problem, library_features, solve_batch
from kinfeas.kinematics.self_collision import CollisionModel, build_collision_model, self_collides
from kinfeas.robots.robot import Robot

ROTATION_WEIGHT = 0.4
"""Metres that one radian of error is worth in the search, where no pose tolerance says
otherwise."""

AIM = 0.2
"""Share of the tolerances at which a descent is content; it may end anywhere within them."""

POSE_DIMENSIONS = 6


@dataclass(frozen=True)
class IkOptions:
    """How hard to search.

    Attributes:
        library: Configurations to restart from, spread over the joint limits.
        restarts: How many of them, those whose EE pose is nearest to the target, are tried.
        candidates: Solutions among which the one nearest to the seed is taken.
        self_collision: Whether solutions in which the robot touches itself are rejected.
        pose tolerance: Whether a robot's own pose tolerance counts as feasible; else only exact
        solutions do.
        position_tolerance: Metres within which a pose counts as reached.
        rotation_tolerance: Radians within which a pose counts as reached.
        max_iterations: Steps of one descent at most.
        centering: How strongly the spare freedom of the arm draws its joints to the middle of their
            ranges, as a share of what they can move in time; 0 for not at all.
    """

    library: Annotated[int, Interval(low=1, high=65536)] = 2048
    restarts: Annotated[int, Interval(low=0, high=65536)] = 24
    candidates: Annotated[int, Interval(low=1, high=65536)] = 3
    self_collision: bool = True
    pose_tolerance: bool = True
    position_tolerance: Positive = 1e-4
    rotation_tolerance: Positive = 1e-3
    max_iterations: Annotated[int, Interval(low=1, high=10_000)] = 40
    centering: Share = 1.0

    def thorough(self) -> "IkOptions":
        """Return options by which the same counts as a solution, searched for as by default."""
        return IkOptions(
            self_collision=self.self_collision,
            pose_tolerance=self.pose_tolerance,
            position_tolerance=self.position_tolerance,
            rotation_tolerance=self.rotation_tolerance,
        )


@dataclass(frozen=True)
class IkSolution:
    """What the solver found for n targets.

    Attributes:
        joint_positions: Solutions, and the seeds where there is none, shape (n, v).
        feasible: Whether a solution was found, shape (n,).
        position_error: Distance that the solution, or the closest attempt free of self-collision,
            leaves, shape (n,), metres.
        rotation_error: The same for the orientation, shape (n,), radians.
    """

    joint_positions: Array
    feasible: NDArray[np.bool_]
    position_error: Array
    rotation_error: Array

    def put(self, rows: NDArray[np.intp], found: "IkSolution") -> None:
        """Put what was found for m of the targets in place of what is here; `rows` is (m,)."""
        for entry in fields(self):
            getattr(self, entry.name)[rows] = getattr(found, entry.name)


class IkSolver:
    """Finds arm configurations that put the EE of one robot at given poses."""

    def __init__(self, robot: Robot, options: IkOptions | None = None) -> None:
        """Prepare the solver for `robot`."""
        self.options = options = options or IkOptions()
        self.robot = robot
        self.chain = build_chain(robot)
        self.collision = build_collision_model(robot)
        self._problem = _make_problem(robot, options, self.chain, self.collision)

    def solve(
        self,
        ee_pose_in_base: Array,
        seed: Array,
        max_joint_step: Array | None = None,
        *,
        allow_reconfiguration: bool = True,
    ) -> IkSolution:
        """Return the solutions nearest to `seed`.

        A descent from the seed comes first if the EE is near the target there: within
        `max_joint_step`, where what the arm has to spare draws its joints to the middle of their
        ranges, and where that fails, as far as the limits allow. Where that fails, too, others
        start from those configurations of a fixed library that bring the EE nearest, and of up to
        `candidates` solutions the one that the arm reaches soonest is taken. The answer is a
        function of the arguments alone, row by row.

        Args:
            ee_pose_in_base: Targets, shape (n, 7).
            seed: Joint positions to begin from, shape (n, v), radians or metres.
            max_joint_step: How far each joint can go from there in time, shape (v,); a solution
                within is taken before any other. By default nothing is known of it.
            allow_reconfiguration: Whether solutions further away than `max_joint_step` are looked
                for, too; without, `max_joint_step` has to be given.

        Raises:
            KinfeasError: If one of them is of another shape, or missing.
        """
        if max_joint_step is None and not allow_reconfiguration:
            raise KinfeasError("without reconfiguration, max_joint_step must be given")
        targets = np.ascontiguousarray(ee_pose_in_base, dtype=np.float64)
        solution = np.array(seed, dtype=np.float64, order="C")
        near = (
            None
            if max_joint_step is None
            else np.ascontiguousarray(max_joint_step, dtype=np.float64)
        )
        self._check_shapes(targets, solution, near)
        feasible = np.empty(len(targets), dtype=np.bool_)
        errors = np.empty((len(targets), 2))
        within = np.empty(0) if near is None else near
        solve_batch(
            self._problem, targets, within, allow_reconfiguration, solution, feasible, errors
        )
        return IkSolution(solution, feasible, errors[:, 0], errors[:, 1])

    def _check_shapes(self, targets: Array, seed: Array, max_joint_step: Array | None) -> None:
        """Raise unless the shapes belong together, for the kernels do not look."""
        joints = self.chain.variables
        if targets.ndim != 2 or targets.shape[1] != 7:
            raise KinfeasError(f"targets must be of shape (n, 7), not {targets.shape}")
        if seed.shape != (len(targets), joints):
            raise KinfeasError(f"seeds must be of shape {len(targets), joints}, not {seed.shape}")
        if max_joint_step is not None and max_joint_step.shape != (joints,):
            raise KinfeasError(
                f"max_joint_step must be of shape ({joints},), not {max_joint_step.shape}"
            )


def _make_problem(
    robot: Robot, options: IkOptions, chain: Chain, collision: CollisionModel
) -> Problem:
    # Copies, for kernels are compiled anew for arrays that are read-only.
    lower, upper = (limit.copy() for limit in robot.joint_limits)
    velocity, continuous = robot.max_joint_velocity.copy(), robot.continuous.copy()
    middle, half = _ranges(lower, upper)
    pose_tolerance = robot.pose_tolerance if options.pose_tolerance else None
    weight = (
        ROTATION_WEIGHT
        if pose_tolerance is None
        else pose_tolerance.position / pose_tolerance.rotation
    )
    library = spread_configurations(robot, options.library)
    if options.self_collision:
        library = library[~self_collides(collision, library)]
    ee_pose = forward(chain, library)
    exact = (options.position_tolerance, options.rotation_tolerance)
    aim = (AIM * exact[0], AIM * exact[1])
    accept = exact if pose_tolerance is None else (pose_tolerance.position, pose_tolerance.rotation)
    return Problem(
        chain=chain,
        descent=Descent(lower, upper, *aim, weight, options.max_iterations),
        collision=collision,
        check_collision=options.self_collision and len(collision.pairs) > 0,
        velocity=velocity,
        continuous=continuous,
        middle=middle,
        centering=_centering(half, options.centering),
        reach=_reach(chain, middle, half),
        library=library,
        features=library_features(ee_pose[:, :3], rotation(ee_pose).as_matrix(), weight),
        restarts=min(options.restarts, len(library)),
        candidates=options.candidates,
        accept_position=accept[0],
        accept_rotation=accept[1],
    )


def spread_configurations(robot: Robot, count: int, seed: int = 0) -> Array:
    """Return `count` configurations that cover the joint limits evenly, shape (count, v).

    Each seed has others, as long as they are fewer than 65536.
    """
    lower, upper = robot.finite_joint_limits
    return lower + (upper - lower) * spread(count, len(robot.arm), seed * 65536)


def _ranges(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return middles and half widths of the joint ranges; 0 and inf where there is no limit."""
    bounded = np.isfinite(upper - lower)
    middle, half = np.zeros_like(lower), np.full_like(lower, np.inf)
    middle[bounded] = (lower[bounded] + upper[bounded]) / 2.0
    half[bounded] = (upper - lower)[bounded] / 2.0
    return middle, half


def _centering(half: Array, strength: float) -> Array:
    """Return what draws joints to their middles, shape (v,), or (0,) if nothing is to.

    An arm of no more joints than a pose has dimensions has nothing to spare.
    """
    if strength == 0.0 or len(half) <= POSE_DIMENSIONS:
        return np.empty(0)
    inverse = np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
    return strength * np.sqrt(inverse)


def _reach(chain: Chain, middle: Array, half: Array) -> Array:
    """Return a ball that no position of the last joint can leave: centre (3,) and radius.

    The sum of the link lengths after the first joint that turns bounds the distance from it; the
    sliding joints before it move that joint along a line, whose half length adds to the radius.
    """
    tree = chain.tree
    turning = np.flatnonzero(~tree.prismatic)
    first = int(turning[0]) if len(turning) else len(tree.variable) - 1
    centre, turn, radius = np.zeros(3), np.eye(3), 0.0
    for i in range(len(tree.variable)):
        slide = float(tree.multiplier[i] * middle[tree.variable[i]] + tree.bias[i])
        play = float(abs(tree.multiplier[i]) * half[tree.variable[i]])
        if i <= first:
            centre = centre + turn @ tree.offset[i]
            turn = turn @ tree.rotation[i]
            if tree.prismatic[i]:
                centre, radius = centre + turn[:, 2] * slide, radius + play
        else:
            radius += float(np.linalg.norm(tree.offset[i]))
            radius += abs(slide) + play if tree.prismatic[i] else 0.0
    return np.array([*centre, radius])


def spread(count: int, dimensions: int, first: int = 0) -> Array:
    """Return points number `first` to `first + count - 1` of the unit cube, (count, dimensions).

    The additive recurrence of the generalised golden ratio (Roberts, "The unreasonable
    effectiveness of quasirandom sequences", 2018). SciPy's sequences would do as well, but their
    import costs a deployed policy a sixth of its memory.
    """
    ratio = 2.0
    for _ in range(64):  # a fixed point of x^(d + 1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    points: Array = (0.5 + np.arange(first, first + count)[:, np.newaxis] * steps) % 1.0
    return points
