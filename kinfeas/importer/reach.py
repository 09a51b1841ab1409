"""What random configurations tell of a robot: links that may touch, a home, useful heights."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, make_pose, rotation, twist_between
from kinfeas.importer.arm import link_pose
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.reachability import at_goals, reachable
from kinfeas.kinematics.self_collision import build_collision_model, checked_links, self_collides
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint, Urdf

OFTEN, ALWAYS = 1.0 / 3.0, 0.95
"""Share of configurations in which near neighbours, and any two links, touch that are built so."""

_NEAR = 2
"""Joints that turn between near neighbours at most: primitives around their meshes overlap."""

WORTH, EASY = 0.8, 0.98
"""Share of goals that can be reached at heights worth learning, and at comfortable ones."""

_PARALLEL = 0.999  # cosine of the angle between two axes
_CONFIGURATIONS, _FEW = 4096, 64
_STEP, _GOALS = 0.1, 48  # metres between heights, and goals at each
_HIGHEST = 100.0  # m, beyond any robot that drives
_STAGES = (4, 16, 64, 256)
_SEARCH = IkOptions(restarts=6, candidates=1)
"""Of IK, from base poses that are many: whether it finds something is enough."""

_OF_SHAPES = "body", "kind", "size", "radius", "rotation", "offset"
"""Attributes of a `CollisionModel` with a row for each shape."""

_SEED = 0
_STIFF = 1e-3
"""Metres or radians that the hand moves for one of a joint, which is none."""


@dataclass(frozen=True)
class Heights:
    """Where goals can be reached from some base pose.

    Attributes:
        at: Heights, ascending, shape (h,), metres.
        share: Of goals of any orientation there, 0-1, shape (h,).
    """

    at: Array
    share: Array

    def band(self, least: float) -> tuple[float, float] | None:
        """Return the largest range of heights in which at least such a share is reached, if any."""
        good = np.concatenate([[False], self.share >= least, [False]])
        edges = np.flatnonzero(good[1:] != good[:-1])
        starts, ends = edges[::2], edges[1::2] - 1
        if not len(starts):
            return None
        longest = int(np.argmax(ends - starts))
        low, high = self.at[starts[longest]], self.at[ends[longest]]
        return (float(low), float(high)) if low < high else None


def built_to_touch(robot: Robot) -> dict[tuple[str, str], float]:
    """Return the pairs of links that may touch, for they are built so or their shapes are too wide.

    These are links that slide in one another, near neighbours that touch often, and others that
    touch always.

    Returns:
        The share of configurations in which each pair touches, 0-1, by their names.
    """
    model, joints = build_collision_model(robot), spread_configurations(robot, _CONFIGURATIONS)
    named = [link.name for link in robot.urdf.links.values() for _ in link.shapes]
    shapes: dict[tuple[str, str], list[int]] = {pair: [] for pair in checked_links(robot)}
    for row, (a, b) in enumerate(model.pairs):
        shapes[min(named[a], named[b]), max(named[a], named[b])].append(row)
    found = {}
    for pair, rows in shapes.items():
        used, places = np.unique(model.pairs[rows], return_inverse=True)
        of_shapes = {key: getattr(model, key)[used] for key in _OF_SHAPES}
        alone = model._replace(**of_shapes, pairs=places.reshape(-1, 2).astype(np.intp))
        share = float(self_collides(alone, joints).mean())
        if share > _allowed(robot, *pair):
            found[pair] = share
    return found


def _allowed(robot: Robot, one: str, other: str) -> float:
    """Return the share of configurations in which two links may touch and still be looked at."""
    urdf, arm = robot.urdf, {joint.name for joint in robot.arm}
    apart = {*urdf.path_to(one)} ^ {*urdf.path_to(other)}
    between = [joint for joint in apart if urdf.followed(joint)[0].name in arm]
    turning = sum(joint.kind != "prismatic" for joint in between)
    if turning == 0 and _in_line(urdf, between):
        return 0.0
    return OFTEN if turning <= _NEAR else ALWAYS


def _in_line(urdf: Urdf, slides: Iterable[Joint]) -> bool:
    """Return whether joints slide along one line, as the parts of a telescope do."""
    poses = [(link_pose(urdf, joint.child, {}), joint.axis) for joint in slides]
    along = [rotation(pose).apply(axis) for pose, axis in poses]
    return all(abs(float(along[0] @ other)) > _PARALLEL for other in along)


def free_share(robot: Robot) -> float:
    """Return the share of configurations in which the robot does not touch itself, 0-1."""
    joints = spread_configurations(robot, _CONFIGURATIONS)
    return float(1.0 - self_collides(build_collision_model(robot), joints).mean())


def comfortable(robot: Robot) -> Array:
    """Return a configuration in which the hand can move any way, shape (j,).

    Of those in which the robot does not touch itself, the hand is ahead of the base, and neither
    low nor high for this arm, it is the most dexterous one: the least singular value of its
    Jacobian, of those that are above 0 at all, less near joint limits (Yoshikawa 1985; Tsai 1986),
    is the largest.

    Raises:
        KinfeasError: If the robot touches itself in all configurations.
    """
    lower, upper = robot.finite_joint_limits
    joints = np.clip(spread_configurations(robot, _CONFIGURATIONS).round(2), lower, upper)
    free = joints[~self_collides(build_collision_model(robot), joints)]
    if not len(free):
        raise KinfeasError(
            f"{robot.name}: in all of {len(joints)} configurations it touches itself"
        )
    ee = forward(build_chain(robot), free)[:, :3]
    low, high = np.quantile(ee[:, 2], [0.25, 0.75])
    wanted = (ee[:, 0] > 0.0) & (ee[:, 2] >= low) & (ee[:, 2] <= high)
    among = free[wanted] if wanted.any() else free
    best: Array = among[np.argmax(_dexterity(robot, among))]
    return best


def freedom(robot: Robot) -> int:
    """Return in how many ways at once the arm can move the hand, 1-6: sliders in line are one."""
    ways = _singular_values(robot, spread_configurations(robot, _FEW)) > _STIFF
    return int(ways.sum(axis=1).max())


def _dexterity(robot: Robot, joints: Array) -> Array:
    """Return how freely the hand moves in configurations (n, j), shape (n,)."""
    lower, upper = robot.finite_joint_limits
    bounded = ~robot.continuous
    room = 4.0 * (joints - lower) * (upper - joints) / (upper - lower) ** 2
    least: Array = _singular_values(robot, joints)[:, freedom(robot) - 1]
    return least * room[:, bounded].min(axis=1, initial=1.0)


def _singular_values(robot: Robot, joints: Array) -> Array:
    """Return those of the Jacobian in configurations (n, j), descending, shape (n, min(6, j))."""
    chain, small = build_chain(robot), 1e-6
    here = forward(chain, joints)
    columns = [
        twist_between(here, forward(chain, joints + small * unit), small)
        for unit in np.eye(joints.shape[1])
    ]
    jacobian = np.stack(columns, axis=-1) * np.repeat([1.0, ROTATION_WEIGHT], 3)[:, np.newaxis]
    values: Array = np.linalg.svd(jacobian, compute_uv=False)
    return values


def useful_heights(robot: Robot, on_done: Callable[[float], None] | None = None) -> Heights:
    """Return how many goals can be reached at which heights, from the floor up.

    The goals have random orientations, as those that a policy learns from. IK decides, from up to
    256 base poses around each of them, to as near as success asks for if the robot has
    pose_tolerance.

    Args:
        robot: The robot.
        on_done: Called with the share of all work, 0-1, that has just been done.

    Raises:
        KinfeasError: If the hand gets higher than any robot's, as with lengths in millimetres.
    """
    solver, rng = IkSolver(robot, at_goals(robot, _SEARCH)), np.random.default_rng(_SEED)
    ee = forward(solver.chain, spread_configurations(robot, _CONFIGURATIONS))[:, 2]
    if (highest := float(ee.max())) > _HIGHEST:
        raise KinfeasError(
            f"{robot.name}: the hand gets {highest:.0f} m high, at most {_HIGHEST:g} are allowed; "
            "lengths in a URDF are metres"
        )
    at = np.arange(_STEP, max(highest, 2.0 * _STEP) + _STEP, _STEP)
    shares = []
    for height in at:
        turn = Rotation.from_euler("xyz", rng.uniform(0.0, 2.0 * np.pi, (_GOALS, 3)))
        goals = make_pose(np.tile([0.0, 0.0, height], (_GOALS, 1)), turn)
        shares.append(reachable(solver, goals, _STAGES).share.value)
        if on_done is not None:
            on_done(1.0 / len(at))
    return Heights(at.round(3), np.array(shares))


def with_pairs(robot: Robot, pairs: Iterable[tuple[str, str]]) -> Robot:
    """Return the robot with pairs of links that may touch, besides those that may already."""
    more = frozenset(map(frozenset, pairs))
    return replace(robot, ignored_collisions=robot.ignored_collisions | more)
