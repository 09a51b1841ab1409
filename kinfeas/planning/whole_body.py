"""Whole-body plans: time-stamped base and arm along an EE path, checked at every moment."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, interpolated, planar_pose, relative
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.planning.base_path import BasePath, BasePathPlanner, path_length
from kinfeas.planning.reach import BasePlacer
from kinfeas.robots.robot import joint_displacement

State = tuple[Array, Array]
"""World pose of the base, shape (7,), and arm joints, shape (j,)."""


@dataclass(frozen=True)
class WholeBodySettings:
    """Settings of plans along EE paths."""

    starts: int = 4  # base poses tried at the beginning of a path
    searches: int = 4  # searches from each, while the path has joint jumps or takes too long
    examined: int = 24  # EE poses that are tried alone if a path has no plan
    slower: tuple[int, ...] = (2, 4)  # factors by which the EE is slower where there is no plan
    longest: float = 300.0  # time that a plan may take, seconds
    apart: float = 0.1  # time from a moment to the next, up to a half more, seconds
    rounds: int = 6  # rounds of finer moments; an arm that is too slow even then counts as jumping
    tolerance: float = 1.2  # factor of the IK tolerances between the poses of the search
    corrections: int = 2  # times that bases are moved by the errors that arms leave
    resting: float = 1e-6  # `path_length` from a pose to the next while the EE rests


_SETTINGS = WholeBodySettings()


@dataclass(frozen=True, eq=False)
class Moments:
    """Base and arm at t times, and the EE pose there."""

    time: Array  # seconds from the start, ascending, shape (t,)
    base: Array  # x, y and unwrapped yaw of the base, shape (t, 3), metres and radians
    joint_positions: Array  # arm joints, those without limits unwrapped, shape (t, j), rad or m
    ee_pose: Array  # desired world poses of the EE, shape (t, 7)

    @property
    def base_pose(self) -> Array:
        """World poses of the base, shape (t, 7)."""
        return planar_pose(*self.base.T)


def plan_along(
    placer: BasePlacer,
    ee: Array,
    step: float,
    start: State | None = None,
    solids: Solids | None = None,
    names: Sequence[str] = (),
) -> Moments:
    """Return base and arm along an EE path, within velocity limits and free of solids.

    Args:
        placer: Of the robot.
        ee: World poses of the EE, shape (k, 7).
        step: Time between successive EE poses, seconds; longer where base or arm need more.
        start: Base and arm now, with the EE at the first pose; by default, one of the best base
            poses for it.
        solids: In the world, one row.
        names: Names of the solids in errors.

    Raises:
        KinfeasError: If there is no plan; with the first pose that is out of reach, if any.
    """
    planner = BasePathPlanner(placer.solver)
    starts = _starts(placer, ee, solids) if start is None else [start]
    moments, reason = _first_plan(planner, placer.solver, starts, ee, step, solids), ""
    if moments is None:
        names = names or [f"solid {k}" for k in range(solids.places if solids else 0)]
        reason = _reason(placer, ee, step, start, solids, names)
    for factor in _SETTINGS.slower:
        if moments is not None or reason or factor * len(ee) * step > _SETTINGS.longest:
            break
        index = np.arange(float(len(ee)))
        slow = interpolated(np.linspace(0.0, index[-1], factor * (len(ee) - 1) + 1), index, ee)
        moments = _first_plan(planner, placer.solver, starts, slow, step, solids)
    if moments is None:
        path = f"one path of base and arm within {_SETTINGS.longest:g} s"
        reason = reason or f"all EE poses are reachable, but not on {path}"
        raise KinfeasError(f"no plan was found: {reason}")
    return moments


def _starts(placer: BasePlacer, ee: Array, solids: Solids | None) -> list[State]:
    placement = placer.place(ee[0], solids, count=_SETTINGS.starts)
    return list(zip(placement.base_pose, placement.joint_positions, strict=True))


def _first_plan(
    planner: BasePathPlanner,
    solver: IkSolver,
    starts: Sequence[State],
    ee: Array,
    step: float,
    solids: Solids | None,
) -> Moments | None:
    """Return the plan from the first of some starts that has one, or None."""
    for base, joints in starts:
        for seed in range(_SETTINGS.searches):
            path = planner.plan(base, joints, ee, step, 0.0, solids=solids, seed=seed)
            if path is None:
                break
            moments = _refined(solver, path, solids)
            if moments is not None and moments.time[-1] <= _SETTINGS.longest:
                return moments
    return None


def _refined(solver: IkSolver, path: BasePath, solids: Solids | None) -> Moments | None:
    """Return base and arm at each EE pose of a path, and at moments between distant ones, or None.

    None means that IK finds no arm near those of the path, which has arms at some EE poses only, an
    arm jumps, or base or arm touches a solid.
    """
    options, motion_time = solver.options, path.motion_time
    near = solver.local(
        centering=0.0,
        position_tolerance=_SETTINGS.tolerance * options.position_tolerance,
        rotation_tolerance=_SETTINGS.tolerance * options.rotation_tolerance,
    )
    for _ in range(_SETTINGS.rounds):
        moments = _moments(near, path, motion_time)
        if moments is None:
            return None
        pieces = np.ceil(np.diff(moments.time) / _SETTINGS.apart - 0.5).clip(1.0)
        if (pieces == 1.0).all():
            break
        index = np.append(0.0, np.cumsum(pieces))
        motion_time = np.interp(np.arange(index[-1] + 1.0), index, motion_time)
    else:
        return None
    if solids is not None:
        base, around = moments.base_pose, solids.repeated(len(moments.time)).at(moments.time)
        if collides(solver.collision, moments.joint_positions, base, around).any():
            return None
    return moments


def _moments(solver: IkSolver, path: BasePath, motion_time: Array) -> Moments | None:
    """Return base and arm at some motion times, within velocity limits, or None if IK fails."""
    robot, pose_times = solver.robot, path.motion_time
    ee = interpolated(motion_time, pose_times, path.ee)
    # Between those of the path, base and arm move in proportion to the EE, or to time if it rests.
    length = path_length(path.ee) + _SETTINGS.resting * np.arange(float(len(pose_times)))
    along, nodes = (np.interp(times, pose_times, length) for times in (motion_time, path.seconds))
    rows = path.robots_at(np.interp(along, nodes, path.seconds))
    arm = _arms(solver, ee, rows)
    joints = arm.joint_positions
    scale = np.array([path.time_scale_at(seconds) for seconds in motion_time[:-1].tolist()])
    moving = np.abs(joint_displacement(robot, joints[:-1], joints[1:])) / robot.max_joint_velocity
    driving = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1) / robot.base.max_velocity
    turning = np.abs(np.diff(rows[:, 2])) / robot.base.max_rotation
    least = np.max([moving.max(axis=1), driving, turning], axis=0)
    planned = np.diff(motion_time) / scale
    if not arm.feasible.all():
        return None
    joints[:, robot.continuous] = np.unwrap(joints[:, robot.continuous], axis=0)
    time = np.append(0.0, np.cumsum(np.maximum(planned, least)))
    return Moments(time, rows[:, :3], joints, ee)


def _arms(solver: IkSolver, ee: Array, rows: Array) -> IkSolution:
    """Return IK solutions for EE poses, (m, 7), near bases and arms `rows`, (m, 3 + j).

    Joints can get there from `rows` within `apart`. If the base can move sideways, bases in `rows`
    after the first are moved by the errors that arms leave.
    """
    robot, base = solver.robot, planar_pose(*rows[:, :3].T)
    step = _SETTINGS.apart * robot.max_joint_velocity
    nearby = partial(solver.solve, max_joint_step=step, allow_reconfiguration=False)
    arm = nearby(relative(ee, base), rows[:, 3:])
    if robot.base.drive == "differential":
        return arm
    for _ in range(_SETTINGS.corrections):
        error = ee - compose(base, forward(solver.chain, arm.joint_positions))
        rows[1:, :2] += error[1:, :2]
        base = planar_pose(*rows[:, :3].T)
        arm = nearby(relative(ee, base), rows[:, 3:])
    return arm


def _reason(
    placer: BasePlacer,
    ee: Array,
    step: float,
    start: State | None,
    solids: Solids | None,
    names: Sequence[str],
) -> str:
    """Return the reason for which the start or an EE pose is infeasible; empty if none is."""
    if start is not None and solids is not None:
        base, joints = start[0][np.newaxis], start[1][np.newaxis]
        (touching,) = placer.touching(base, joints, solids)
        if touching.any():
            return f"at the start base or arm touches {names[int(touching.argmax())]}"
    for index in np.unique(np.linspace(0, len(ee) - 1, _SETTINGS.examined).astype(int)).tolist():
        among = None if solids is None else solids.at(np.array([index * step]))
        reason = placer.place(ee[index], among, count=1).named(names).reason
        if reason:
            position = ", ".join(f"{value:.3g}" for value in ee[index, :3].tolist())
            return f"EE at {position} m after {index * step:.1f} s: {reason}"
    return ""
