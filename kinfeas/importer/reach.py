"""Properties of a robot from sampled configurations: links that may touch, home and reach."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose
from kinfeas.importer.arm import axis_in_root
from kinfeas.importer.boxed import Part
from kinfeas.kinematics.forward import build_chain, forward, jacobian
from kinfeas.kinematics.gravity import build_gravity_model, overloaded
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import (
    CollisionModel,
    build_collision_model,
    checked_links,
    self_collides,
)
from kinfeas.planning.placement import at_goals, reachable
from kinfeas.robots.fcl_shapes import fcl_object, place, touch
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint, Shape, Urdf

OFTEN, ALWAYS = 1.0 / 3.0, 0.95
"""Fractions of configurations above which near neighbours, or any links, touch by design."""

_NEAR = 2
"""Most revolute joints between near neighbours; primitives around their meshes overlap."""

LOAD = 0.7
"""Largest gravity torque as a fraction of the effort limit; motors also accelerate the arm."""

_HELD = 0.02
"""Least fraction of configurations that can be held; effort limits for fewer are placeholders."""

RELEVANT = 0.01
"""Fraction of configurations from which on a false contact matters."""

_COMPARED = 256  # configurations in which the parts of a pair are compared at most
_PARALLEL = 0.999  # cosine of the angle between two axes
_FEW = 64  # configurations that show the degrees of freedom
_STEP, _GOALS = 0.1, 48  # m between heights, and goals at each
_MAX_HEIGHT = 100.0  # m
_STAGES = (4, 16, 64, 256)  # base poses tried around a goal by the end of each stage
_SEARCH = IkOptions(restarts=6, candidates=1)  # a quick one, since many base poses are tried
_STIFF = 1e-3  # singular values below count as zero


@dataclass(frozen=True)
class Heights:
    """Ascending heights in metres, and the fractions of reachable goals there, 0-1, shape (h,)."""

    at: Array
    fraction: Array

    def band(self, least: float) -> tuple[float, float] | None:
        """Return the largest range of heights with a fraction of at least `least`, or None."""
        good = np.concatenate([[False], self.fraction >= least, [False]])
        edges = np.flatnonzero(good[1:] != good[:-1])
        starts, ends = edges[::2], edges[1::2] - 1
        if not len(starts):
            return None
        longest = int(np.argmax(ends - starts))
        low, high = self.at[starts[longest]], self.at[ends[longest]]
        return (float(low), float(high)) if low < high else None


def sampled(robot: Robot) -> Array:
    """Return configurations spread over the limits, shape (n, j), for fractions of a draft."""
    return spread_configurations(robot, 4096)


def touching(robot: Robot) -> dict[tuple[str, str], float]:
    """Return the fraction of configurations, 0-1, in which each checked pair of links touches."""
    joints = sampled(robot)
    return {pair: float(self_collides(alone, joints).mean()) for pair, alone in pair_models(robot)}


def pair_models(robot: Robot) -> Iterator[tuple[tuple[str, str], CollisionModel]]:
    """Yield each checked pair of links with a collision model that checks it alone."""
    model = build_collision_model(robot)
    named = [link.name for link in robot.urdf.links.values() for _ in link.shapes]
    shapes: dict[tuple[str, str], list[int]] = {pair: [] for pair in checked_links(robot)}
    for row, (a, b) in enumerate(model.pairs):
        shapes[min(named[a], named[b]), max(named[a], named[b])].append(row)
    for pair, rows in shapes.items():
        used, indices = np.unique(model.pairs[rows], return_inverse=True)
        names = ("body", "kind", "size", "radius", "rotation", "offset")
        own = {name: getattr(model, name)[used] for name in names}
        pairs = indices.reshape(-1, 2).astype(np.uintp)
        above = np.zeros(len(used), dtype=np.bool_)
        yield pair, model._replace(**own, pairs=pairs, apart=model.apart[rows], above=above)


def built_to_touch(
    robot: Robot, fractions: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], float]:
    """Return the pairs of links that touch by design, or since their shapes are too large.

    These are links that slide in one another and touch at all, near neighbours that touch often,
    and others that touch almost always. `fractions` are those of `touching`.
    """
    return {
        pair: fraction for pair, fraction in fractions.items() if fraction > _allowed(robot, *pair)
    }


def _allowed(robot: Robot, first: str, second: str) -> float:
    """Return the fraction of configurations in which two links may touch and are still checked."""
    urdf, arm = robot.urdf, {joint.name for joint in robot.arm}
    apart = {*urdf.path_to(first)} ^ {*urdf.path_to(second)}
    between = [joint for joint in apart if urdf.followed(joint)[0].name in arm]
    turning = sum(joint.kind != "prismatic" for joint in between)
    if turning == 0 and _in_line(urdf, between):
        return 0.0
    return OFTEN if turning <= _NEAR else ALWAYS


def _in_line(urdf: Urdf, slides: Iterable[Joint]) -> bool:
    """Return whether prismatic joints have parallel axes, as the parts of a telescope have."""
    along = [axis_in_root(urdf, joint) for joint in slides]
    return all(abs(float(along[0] @ axis)) > _PARALLEL for axis in along)


def only_fitted(
    robot: Robot, originals: Mapping[str, Sequence[Part]], touching: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], float]:
    """Return the pairs of links whose primitives touch in relevant fractions, but not their meshes.

    The `originals`, from `boxed_urdf`, touch in none of the configurations that are compared.
    `touching` has the fraction of configurations in which each checked pair touches.
    """
    suspected = {
        pair: fraction
        for pair, fraction in touching.items()
        if fraction >= RELEVANT and not originals.keys().isdisjoint(pair)
    }
    if not suspected:
        return {}
    joints = sampled(robot)

    @cache
    def solids(link: str) -> list[tuple[Any, Array]]:
        parts = originals.get(link, robot.urdf.links[link].shapes)
        poses = (part.pose if isinstance(part, Shape) else IDENTITY for part in parts)
        return list(zip(map(fcl_object, parts), poses, strict=True))

    def placed(link: str, joints: Array) -> list[tuple[Any, Array]]:
        poses = forward(build_chain(replace(robot, ee_frame=link)), joints)
        return [
            (solid, compose(poses, np.broadcast_to(pose, poses.shape)))
            for solid, pose in solids(link)
        ]

    def touch_at(first: tuple[Any, Array], second: tuple[Any, Array], i: int) -> bool:
        for solid, poses in (first, second):
            place(solid, poses[i])
        return touch(first[0], second[0])

    def touch_somewhere(pair: tuple[str, str], alone: CollisionModel) -> bool:
        rows = np.flatnonzero(self_collides(alone, joints))
        some = joints[rows[:: -(-len(rows) // _COMPARED)]]
        parts = list(product(*(placed(link, some) for link in pair)))
        return any(touch_at(first, second, i) for i in range(len(some)) for first, second in parts)

    return {
        pair: suspected[pair]
        for pair, alone in pair_models(robot)
        if pair in suspected and not touch_somewhere(pair, alone)
    }


def free_fraction(robot: Robot) -> float:
    """Return the fraction of configurations without self-collision, 0-1."""
    return float(1.0 - self_collides(build_collision_model(robot), sampled(robot)).mean())


def overload_fractions(robot: Robot) -> dict[str, float]:
    """Return the joints whose effort limit gravity exceeds in some configurations.

    The values are the fractions of configurations, 0-1.
    """
    fractions = _overloaded(robot, sampled(robot)).mean(axis=0).tolist()
    joints = zip(robot.arm, fractions, strict=True)
    return {joint.name: fraction for joint, fraction in joints if fraction}


def overloads_at(robot: Robot, joints: Array) -> tuple[str, ...]:
    """Return the joints whose effort limit gravity exceeds in a configuration (j,)."""
    beyond = _overloaded(robot, joints)
    return tuple(joint.name for joint, over in zip(robot.arm, beyond, strict=True) if over)


def _overloaded(robot: Robot, joints: Array) -> NDArray[np.bool_]:
    return overloaded(build_gravity_model(replace(robot, max_gravity_load=1.0)), joints)


def limited(robot: Robot) -> Robot:
    """Return the robot with a `max_gravity_load`, unless it can hold hardly any configuration."""
    held = replace(robot, max_gravity_load=LOAD)
    return held if IkSolver(held).admissible(sampled(held)).mean() >= _HELD else robot


def comfortable(robot: Robot) -> Array:
    """Return the configuration with the highest dexterity, shape (j,).

    The candidates are free of self-collision and can be held, with the hand in front of the base at
    medium height.
    Dexterity is the least singular value of the Jacobian, without those that are always zero, less
    near joint limits (Yoshikawa 1985; Tsai 1986).
    """
    lower, upper = robot.finite_joint_limits
    joints = np.clip(sampled(robot).round(2), lower, upper)
    free = joints[IkSolver(robot).admissible(joints)]
    if not len(free):
        raise KinfeasError(f"{robot.name}: self-collision in all of {len(joints)} configurations")
    ee = forward(build_chain(robot), free)[:, :3]
    low, high = np.quantile(ee[:, 2], [0.25, 0.75])
    in_front = (ee[:, 0] > 0.0) & (ee[:, 2] >= low) & (ee[:, 2] <= high)
    among = free[in_front] if in_front.any() else free
    least = _singular_values(robot, among)[:, freedom(robot) - 1]
    room = 4.0 * (among - lower) * (upper - among) / (upper - lower) ** 2
    return among[np.argmax(least * room[:, ~robot.continuous].min(axis=1, initial=1.0))]


def freedom(robot: Robot) -> int:
    """Return the degrees of freedom of the hand, 1-6; parallel prismatic joints count once."""
    directions = _singular_values(robot, spread_configurations(robot, _FEW)) > _STIFF
    return int(directions.sum(axis=1).max())


def _singular_values(robot: Robot, joints: Array) -> Array:
    """Return the Jacobian's singular values at joints (n, j), descending, (n, min(6, j))."""
    weights = np.repeat([1.0, ROTATION_WEIGHT], 3)[:, np.newaxis]
    return np.linalg.svd(jacobian(build_chain(robot), joints) * weights, compute_uv=False)


def useful_heights(robot: Robot, on_done: Callable[[float], None] | None = None) -> Heights:
    """Return the fraction of reachable goals by height, from the floor up.

    Goals have random orientations. A goal is reachable if IK solves it from one of up to 256 base
    poses around it, within the tolerances of success. `on_done` is called with the fraction of all
    work, 0-1, that has just been done.
    """
    solver, rng = IkSolver(robot, at_goals(robot, _SEARCH)), np.random.default_rng(0)
    ee = forward(solver.chain, sampled(robot))[:, 2]
    if (highest := float(ee.max())) > _MAX_HEIGHT:
        raise KinfeasError(
            f"{robot.name}: the hand gets {highest:.0f} m high, at most {_MAX_HEIGHT:g} are "
            "allowed; lengths in a URDF are metres"
        )
    at = np.arange(_STEP, max(highest, 2.0 * _STEP) + _STEP, _STEP)
    fractions = []
    for height in at:
        orientation = Rotation.from_euler("xyz", rng.uniform(0.0, 2.0 * np.pi, (_GOALS, 3)))
        goals = make_pose(np.tile([0.0, 0.0, height], (_GOALS, 1)), orientation)
        fractions.append(reachable(solver, goals, _STAGES).share.value)
        if on_done is not None:
            on_done(1.0 / len(at))
    return Heights(at.round(3), np.array(fractions))
