"""Inverse kinematics: verified, within joint limits, deterministic."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Fraction, NotNegative, Positive
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, rotation
from kinfeas.kinematics.descent import Descent, Limits
from kinfeas.kinematics.forward import Chain, build_chain, forward
from kinfeas.kinematics.gravity import build_gravity_model, overloaded
from kinfeas.kinematics.search import SEARCH, Problem, library_features, solve_batch
from kinfeas.kinematics.self_collision import build_collision_model, self_collides
from kinfeas.kinematics.solids import solid_arrays
from kinfeas.robots.robot import Robot

ROTATION_WEIGHT = 0.4
"""Metres equivalent to one radian of error in the search of robots without pose tolerance."""

POSE_DIMENSIONS = 6

_NO_SOLIDS = solid_arrays(Solids.empty(1), 1)


@dataclass(frozen=True)
class IkOptions:
    """Options of the IK solver."""

    # number of configurations to restart from, spread over the joint limits
    library: Annotated[int, Interval(ge=1, le=65536)] = 2048
    # largest number of restarts, from those with the EE nearest to the target
    restarts: Annotated[int, Interval(ge=0, le=65536)] = 24
    # number of solutions of which the one nearest to the seed is taken
    candidates: Annotated[int, Interval(ge=1, le=65536)] = 3
    # whether solutions that touch the robot or the floor are rejected. Those that motors cannot
    # hold always are
    self_collision: bool = True
    pose_tolerance: bool = True  # whether the robot's pose tolerance counts as feasible
    position_tolerance: Positive = 1e-4  # position error of an exact solution, metres
    rotation_tolerance: Positive = 1e-3  # rotation error of an exact solution, radians
    # largest number of steps of a descent
    max_iterations: Annotated[int, Interval(ge=1, le=10_000)] = 40
    # distance that solutions keep from solids, metres. Where arms may be reconfigured, those that
    # are nearer count, too, if there are no others
    solid_clearance: NotNegative = 0.0
    # pull of a redundant arm's joints towards the middles of their ranges, as a fraction of the
    # largest joint step; 0 for none
    centering: Fraction = 1.0
    # distance that solutions keep from joint limits, as a fraction of half of the range; joints
    # whose seed is nearer may stay there
    joint_margin: Fraction = 0.0
    # distance that the robot's shapes keep from each other, metres, if they do so at `home`
    self_clearance: NotNegative = 0.0

    def thorough(self) -> "IkOptions":
        """Return options that accept the same solutions and search no less than the default."""
        efforts = "library", "restarts", "candidates", "max_iterations", "centering"
        default = IkOptions()
        return replace(self, **{k: max(getattr(self, k), getattr(default, k)) for k in efforts})


@dataclass(frozen=True)
class IkSolution:
    """Solutions for n targets."""

    joint_positions: Array  # solutions, or the seeds where there is none, shape (n, v)
    feasible: NDArray[np.bool_]  # whether a solution was found, shape (n,)
    position_error: Array  # of the solution or closest attempt, shape (n,), metres
    rotation_error: Array  # of the solution or closest attempt, shape (n,), radians

    def put(self, rows: NDArray[np.intp], solutions: "IkSolution") -> None:
        """Replace the solutions of the targets `rows`, shape (m,), by m other ones."""
        for entry in fields(self):
            getattr(self, entry.name)[rows] = getattr(solutions, entry.name)


class IkSolver:
    """Solves IK for batches of EE poses of one robot."""

    def __init__(self, robot: Robot, options: IkOptions | None = None) -> None:
        self.options = options = options or IkOptions()
        self.robot = robot
        self.chain = build_chain(robot)
        self.collision = build_collision_model(robot, options.self_clearance)
        self.gravity = build_gravity_model(robot)
        self._problem = _make_problem(self)

    def local(self, **changes: Any) -> "IkSolver":
        """Return a solver with changed options that searches from seeds and posture guides only."""
        return IkSolver(self.robot, replace(self.options, restarts=0, library=1, **changes))

    def admissible(self, joint_positions: Array) -> NDArray[np.bool_]:
        """Return which postures (..., v) are free of self-collision and can be held, shape (...).

        Motors hold any posture unless the robot has a `max_gravity_load`.
        """
        admissible = ~self_collides(self.collision, joint_positions)
        if self.gravity.limited:
            admissible &= ~overloaded(self.gravity, joint_positions).any(axis=-1)
        return admissible

    def solve(
        self,
        ee_pose_in_base: Array,
        seed: Array,
        max_joint_step: Array | None = None,
        *,
        allow_reconfiguration: bool = True,
        solids: Solids | None = None,
        posture_guide: Array | None = None,
    ) -> IkSolution:
        """Return the solutions nearest to `seed`.

        If the EE is near the target at the seed, the search begins there: first within
        `max_joint_step`, where redundant arms centre their joints, then within the joint limits.
        Otherwise, or if that fails, it restarts from configurations of a fixed library, those with
        the EE nearest to the target first. Of up to `candidates` solutions from there, it takes the
        one that the arm reaches soonest. Each row's solution depends on that row's arguments alone.

        Args:
            ee_pose_in_base: Targets, shape (n, 7).
            seed: First joint positions, shape (n, v), radians or metres.
            max_joint_step: Largest displacement of each joint in one control step, shape (v,);
                solutions within it come first. In these, a joint whose seed is beyond a joint limit
                may stay there, but not go farther beyond.
            allow_reconfiguration: Whether solutions beyond `max_joint_step` are allowed.
            solids: n rows, in the base frame. In a solution, no shape that the arm moves touches
                them.
            posture_guide: Preferred joint positions, shape (n, v); NaN for none. The search begins
                as near to them as `max_joint_step` allows and, beyond this step, at the guide
                itself. Without `max_joint_step`, guides have no effect.

        Raises:
            KinfeasError: If an array has another shape, or `max_joint_step` is needed and missing.
        """
        if max_joint_step is None and not allow_reconfiguration:
            raise KinfeasError("without reconfiguration, max_joint_step must be given")
        n, joints = len(ee_pose_in_base), self.chain.variables
        targets = _checked("targets", ee_pose_in_base, (n, 7))
        solution = _checked("seeds", seed, (n, joints)).copy()
        step, guide = np.empty(0), np.empty((0, joints))
        if max_joint_step is not None:
            step = _checked("max_joint_step", max_joint_step, (joints,))
        if posture_guide is not None:
            guide = _checked("posture guides", posture_guide, (n, joints))
        around = _NO_SOLIDS if solids is None else solid_arrays(solids, n)
        clearance = 0.0 if solids is None else self.options.solid_clearance
        feasible, errors = np.empty(n, dtype=np.bool_), np.empty((n, 2))
        # No arm is reconfigured only to keep the clearance.
        anywhere = allow_reconfiguration and not (clearance and len(step))
        results = solution, feasible, errors
        solve_batch(self._problem, targets, step, anywhere, guide, around, clearance, *results)
        rows = (~feasible).nonzero()[0]
        if clearance and allow_reconfiguration and rows.size:
            guide = guide[rows] if len(guide) else guide
            among = tuple(values[rows] for values in around)
            again = solution[rows], feasible[rows], errors[rows]
            solve_batch(self._problem, targets[rows], step, True, guide, among, 0.0, *again)
            for values, new in zip(results, again, strict=True):
                values[rows] = new
        return IkSolution(solution, feasible, errors[:, 0], errors[:, 1])


def _checked(name: str, values: Array, shape: tuple[int, ...]) -> Array:
    """Return values as an array for kernels; raise KinfeasError unless it has this shape."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise KinfeasError(f"{name} must be of shape {shape}, not {array.shape}")
    return array


def _make_problem(solver: IkSolver) -> Problem:
    robot, options, chain = solver.robot, solver.options, solver.chain
    # Copies, since kernels are compiled again for read-only arrays.
    lower, upper = (limit.copy() for limit in robot.joint_limits)
    velocity, continuous = robot.max_joint_velocity.copy(), robot.continuous.copy()
    middle, half = _ranges(lower, upper)
    margin = options.joint_margin * np.where(np.isfinite(half), half, 0.0)
    lower, upper = lower + margin, upper - margin
    position, radians = options.position_tolerance, options.rotation_tolerance
    aim, weight = (SEARCH.aim * position, SEARCH.aim * radians), ROTATION_WEIGHT
    if options.pose_tolerance and robot.pose_tolerance is not None:
        position, radians = robot.pose_tolerance.position, robot.pose_tolerance.rotation
        weight = position / radians
    library = spread_configurations(robot, options.library).clip(lower, upper)
    if options.self_collision:
        library = library[~self_collides(solver.collision, library)]
    library = library[~overloaded(solver.gravity, library).any(axis=1)]
    ee_pose = forward(chain, library)
    return Problem(
        chain=chain,
        descent=Descent(*aim, weight, options.max_iterations),
        collision=solver.collision,
        check_collision=options.self_collision,
        load=solver.gravity.load if solver.gravity.limited else np.empty((0, 6)),
        limits=Limits(lower, upper), velocity=velocity, continuous=continuous, middle=middle,
        centering=_centering(half, options.centering),
        reach=_reach(chain, middle, half),
        library=library,
        features=library_features(ee_pose[:, :3], rotation(ee_pose).as_matrix(), weight),
        restarts=min(options.restarts, len(library)), candidates=options.candidates,
        accept_position=position, accept_rotation=radians,
    )  # fmt: skip


def spread_configurations(robot: Robot, count: int, seed: int = 0) -> Array:
    """Return configurations that cover the joint limits evenly, shape (count, v).

    Different seeds have different configurations, for counts of up to 65536.
    """
    lower, upper = robot.finite_joint_limits
    return lower + (upper - lower) * spread(count, len(robot.arm), seed * 65536)


def _ranges(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return middles and half widths of the joint ranges; 0 and inf without limits."""
    bounded = np.isfinite(upper - lower)
    middle, half = np.zeros_like(lower), np.full_like(lower, np.inf)
    middle[bounded] = (lower[bounded] + upper[bounded]) / 2.0
    half[bounded] = (upper - lower)[bounded] / 2.0
    return middle, half


def _centering(half: Array, strength: float) -> Array:
    """Return `Problem.centering`, shape (v,), or (0,) for arms that are not redundant."""
    if strength == 0.0 or len(half) <= POSE_DIMENSIONS:
        return np.empty(0)
    inverse = np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
    return strength * np.sqrt(inverse)


def _reach(chain: Chain, middle: Array, half: Array) -> Array:
    """Return the centre and radius of a ball in the base frame that contains the last joint, (4,).

    The centre is the first revolute joint, where prismatic joints before it are at the middles of
    their ranges. Half of these ranges and the lengths of all links beyond add up to the radius.
    """
    tree = chain.tree
    turning = np.flatnonzero(~tree.prismatic)
    first = int(turning[0]) if len(turning) else len(tree.variable) - 1
    centre, orientation, radius = np.zeros(3), np.eye(3), 0.0
    for i in range(len(tree.variable)):
        position = float(tree.multiplier[i] * middle[tree.variable[i]] + tree.bias[i])
        half_range = float(abs(tree.multiplier[i]) * half[tree.variable[i]])
        if i <= first:
            centre = centre + orientation @ tree.offset[i]
            orientation = orientation @ tree.rotation[i]
            if tree.prismatic[i]:
                centre, radius = centre + orientation[:, 2] * position, radius + half_range
        else:
            radius += float(np.linalg.norm(tree.offset[i]))
            radius += abs(position) + half_range if tree.prismatic[i] else 0.0
    return np.array([*centre, radius])


def spread(count: int, dimensions: int, first: int = 0) -> Array:
    """Return quasirandom points of the unit cube, shape (count, dimensions).

    These are numbers `first` to `first + count - 1` of the additive recurrence of the generalised
    golden ratio (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018). SciPy's
    sequences take a sixth more memory in a deployed policy.
    """
    ratio = 2.0
    for _ in range(64):  # a fixed point of x^(d + 1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    return (0.5 + np.arange(first, first + count)[:, np.newaxis] * steps) % 1.0
