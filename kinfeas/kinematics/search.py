"""The search of IK: descents from the seed, then from a library of configurations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import copy_row, inlined, inner, kernel, square
from kinfeas.core.solid_kernels import is_empty
from kinfeas.core.spatial import Array
from kinfeas.kinematics.descent import Descent, Limits, Scratch, descend, make_scratch, measure
from kinfeas.kinematics.forward import Chain, place_chain, write_matrix
from kinfeas.kinematics.gravity import overloads
from kinfeas.kinematics.self_collision import (
    CollisionModel,
    CollisionScratch,
    make_collision_scratch,
    place_shapes,
    touches_itself,
)
from kinfeas.kinematics.solids import bounds, touches_solids


class SearchSettings(NamedTuple):
    """Settings of the search."""

    aim: float = 0.2  # fraction of the tolerances at which a descent ends
    warm_cost: float = 0.3**2  # squared error up to which descents begin at the seed, m^2
    restarts: int = 6  # restarts after which a hopeless search ends
    hopeless_cost: float = 0.02**2  # a search is hopeless if all its squared errors exceed it, m^2


SEARCH = SearchSettings()

GUIDED, CENTRED, NEAR, FROM_GUIDE, ANYWHERE = range(5)
"""Descents of a search from a seed, in this order. The first three keep to `max_joint_step`: one
towards the guide, one that centres the joints, one that does neither. The last two keep to the
joint limits: one begins at the guide, one at the seed or where `NEAR` has ended."""


class Problem(NamedTuple):
    """Constants of a robot's search.

    Redundant arms move towards the middles of their joint ranges. As a fraction of `max_joint_step`
    they move by `centering` times the square root of the distance from the middle.
    """

    chain: Chain  # from base to EE, driven by v variables
    descent: Descent  # options of a descent
    collision: CollisionModel  # self-collision model
    check_collision: bool  # whether self-collision is checked
    load: Array  # of a `GravityModel`, shape (m, 6); (0, 6) if gravity torques have no limits
    limits: Limits  # joint limits
    velocity: Array  # joint velocity limits, shape (v,)
    continuous: NDArray[np.bool_]  # whether joints are continuous, shape (v,)
    middle: Array  # middles of the joint ranges, shape (v,)
    centering: Array  # factors of the motion towards the middles, shape (v,); (0,) for none
    reach: Array  # centre and radius of a ball that contains the last joint, shape (4,), metres
    library: Array  # configurations to restart from, shape (l, v)
    features: NDArray[np.float32]  # `library_features`, shape (13, l)
    restarts: int  # largest number of restarts
    candidates: int  # number of solutions of which the nearest is taken
    accept_position: float  # position error of a feasible pose, metres
    accept_rotation: float  # rotation error of a feasible pose, radians


def library_features(position: Array, orientation: Array, weight: float) -> NDArray[np.float32]:
    """Return features that rank library entries by their EE's distance to a target, (13, l).

    |p - p'|^2 + (weight^2 / 2) |R - R'|^2 is, except for terms of the target alone, a sum of
    products of an entry's features with the target's. EE positions have shape (l, 3), orientations
    (l, 3, 3); `weight` is in metres per radian.
    """
    squares = np.sum(np.square(position), axis=1, keepdims=True)
    rows = [squares, -2.0 * position, -(weight**2) * orientation.reshape(-1, 9)]
    return np.ascontiguousarray(np.concatenate(rows, axis=1).T, dtype=np.float32)


@kernel
def solve_batch(
    problem: Problem, targets, max_joint_step, allow_reconfiguration, guide, solids, clearance,
    solution, feasible, errors,
):  # fmt: skip
    """Solve row by row; arguments are as in `IkSolver.solve`.

    Without a limit, `max_joint_step` has shape (0,). Arms keep `clearance` metres from `solids`,
    which are `SolidArrays`. Without solids or guides, these arrays may have fewer rows.

    `solution`, shape (n, v), has the seeds and receives the solutions; `feasible`, shape (n,),
    receives whether there is one; `errors`, shape (n, 2), receives the errors of the solution or
    the closest attempt, metres and radians.
    """
    joints, n = solution.shape[1], len(solution)
    memory = Memory(
        make_scratch(len(problem.chain.tree.variable), joints),
        make_collision_scratch(problem.collision),
        _make_limits(joints), _make_limits(joints), _make_limits(joints),
    )  # fmt: skip
    order = np.empty(problem.restarts, dtype=np.intp)
    scores = np.empty(len(problem.library), dtype=np.float32)
    orientation = np.empty((3, 3))
    pose, size, cylinder = solids
    grown = np.empty(size.shape[1:])
    for i in range(n):
        write_matrix(targets[i], orientation)
        target = orientation, targets[i, :3]
        row = min(i, len(pose) - 1)
        _grow(size[row], clearance, grown)
        around = pose[row], grown, cylinder[row]
        query = IkQuery(target, guide[i : i + 1], around, solution[i], errors[i])
        if _solve_from_seed(problem, query, max_joint_step, allow_reconfiguration, memory):
            feasible[i] = True
        elif not allow_reconfiguration or problem.restarts == 0 or _out_of_reach(problem, target):
            feasible[i] = False
        else:
            _rank_library(problem, target, scores, order)
            feasible[i] = _solve_from_library(problem, query, order, memory)
        for j in range(joints):
            if feasible[i] and problem.continuous[j]:
                solution[i, j] = _wrap(solution[i, j])


class IkQuery(NamedTuple):
    """One row of a batch."""

    target: tuple[Array, Array]  # EE orientation in the base frame, (3, 3), and position, (3,)
    guide: Array  # shape (1, v) or (0, v)
    around: tuple[Array, Array, NDArray[np.bool_]]  # `SolidArrays` of the row, with the clearance
    solution: Array  # the seed, which a solution replaces, shape (v,)
    error: Array  # of the solution or the closest attempt, shape (2,), metres and radians


class Memory(NamedTuple):
    """Memory of a search, allocated once for a whole batch."""

    scratch: Scratch
    collision: CollisionScratch
    seeded: Limits  # joint limits, widened to the seed where it is beyond, since joints cannot jump
    near: Limits  # limits within `seeded` and within `max_joint_step` of the seed
    guided: Limits  # limits within `near` and within `max_joint_step` of where GUIDED begins


@kernel
def _make_limits(joints):
    return Limits(np.empty(joints), np.empty(joints))


@inlined
def _solve_from_seed(problem, query, max_joint_step, allow_reconfiguration, memory):
    """Descend from the seed if it is near the target; return whether there is a solution."""
    scratch, q, seeded = memory.scratch, memory.scratch.trial, memory.seeded
    stepwise = len(max_joint_step) > 0
    guided = stepwise and len(query.guide) > 0 and not math.isnan(query.guide[0, 0])
    enabled = (
        guided,  # GUIDED
        stepwise and len(problem.centering) > 0,  # CENTRED
        stepwise,  # NEAR
        guided and allow_reconfiguration,  # FROM_GUIDE
        allow_reconfiguration,  # ANYWHERE
    )
    _write_seeded(problem.limits, query.solution, stepwise, seeded)
    _begin_at(problem, seeded, query.solution, scratch)
    far = _chordal_cost(problem, query.target, scratch.frames) > SEARCH.warm_cost
    at_seed = measure(query.target, scratch)
    query.error[0], query.error[1] = at_seed
    if far:
        return False
    if stepwise:
        _write_near(seeded, q, max_joint_step, memory.near)
    for attempt in range(len(enabled)):
        if not enabled[attempt]:
            continue
        limits = memory.near if attempt <= NEAR else problem.limits
        if attempt == GUIDED:
            limits = memory.guided
            _go_to_guide(problem, max_joint_step, query.guide[0], memory, q)
            place_chain(problem.chain, q, scratch.frames)
        elif attempt == CENTRED:
            _centre(problem, max_joint_step, q, scratch.pull)
        elif attempt == FROM_GUIDE:
            _begin_at(problem, limits, query.guide[0], scratch)
        metres, radians = descend(problem.chain, problem.descent, limits, query.target, q, scratch)
        scale = SEARCH.aim if attempt == GUIDED else 1.0  # a guide must not cost accuracy
        if _close_enough(problem, metres / scale, radians / scale):
            if _free(problem, query, q, memory):
                return _accept(query, q, metres, radians)
        elif _improves(problem, query, q, metres, radians, memory):
            query.error[0], query.error[1] = metres, radians
        if attempt in (GUIDED, CENTRED, FROM_GUIDE):
            _begin_at(problem, seeded, query.solution, scratch)
    # With a pose tolerance, the seed itself may be a solution that every descent has left.
    metres, radians = at_seed
    if not _close_enough(problem, metres, radians):
        return False
    _clip(seeded, query.solution, q)
    return _free(problem, query, q, memory) and _accept(query, q, metres, radians)


@inlined
def _accept(query, q, metres, radians):
    query.error[0], query.error[1] = metres, radians
    copy_row(q, query.solution)
    return True


@inlined
def _write_seeded(limits, seed, stepwise, out):
    for j in range(len(seed)):
        out.lower[j] = min(limits.lower[j], seed[j]) if stepwise else limits.lower[j]
        out.upper[j] = max(limits.upper[j], seed[j]) if stepwise else limits.upper[j]


@inlined
def _write_near(limits, q, step, out):
    for j in range(len(q)):
        out.lower[j] = max(limits.lower[j], q[j] - step[j])
        out.upper[j] = min(limits.upper[j], q[j] + step[j])


@inlined
def _begin_at(problem, limits, start, scratch):
    _clip(limits, start, scratch.trial)
    place_chain(problem.chain, scratch.trial, scratch.frames)


@inlined
def _clip(limits, values, q):
    for j in range(len(q)):
        q[j] = min(max(values[j], limits.lower[j]), limits.upper[j])


@inlined
def _chordal_cost(problem, target, frames):
    """Return |p - p'|^2 + (weight^2 / 2) |R - R'|^2, m^2, between target and EE."""
    cost, trace = 0.0, 0.0
    for i in range(3):
        cost += square(target[1][i] - frames.position[i])
        for k in range(3):
            trace += target[0][i, k] * frames.rotation[i, k]
    return cost + square(problem.descent.rotation_weight) * (3.0 - trace)


@inlined
def _go_to_guide(problem, step, guide, memory, q):
    """Move `q` towards the guide, within the limits `near`; write the limits `guided` around it."""
    near = memory.near
    for j in range(len(q)):
        move = guide[j] - q[j]
        move = _wrap(move) if problem.continuous[j] else move
        q[j] = min(max(q[j] + move, near.lower[j]), near.upper[j])
    _write_near(near, q, step, memory.guided)


@inlined
def _centre(problem, max_joint_step, q, pull):
    """Write the pull of the joints towards the middles of their ranges, not beyond them."""
    for j in range(len(q)):
        away = q[j] - problem.middle[j]
        length = problem.centering[j] * math.sqrt(abs(away)) * max_joint_step[j]
        pull[j] = -math.copysign(min(length, abs(away)), away)


@inlined
def _solve_from_library(problem, query, order, memory):
    """Descend from library entries; keep the solution nearest to the seed."""
    scratch, q, seed, error = memory.scratch, memory.scratch.trial, memory.scratch.seed, query.error
    copy_row(query.solution, seed)
    closest = _cost(problem, error[0], error[1])
    nearest, solutions = np.inf, 0
    for attempt in range(len(order)):
        if attempt >= SEARCH.restarts and closest > SEARCH.hopeless_cost:
            break
        copy_row(problem.library[order[attempt]], q)
        place_chain(problem.chain, q, scratch.frames)
        metres, radians = descend(
            problem.chain, problem.descent, problem.limits, query.target, q, scratch
        )
        closest = min(closest, _cost(problem, metres, radians))
        if _close_enough(problem, metres, radians):
            if not _free(problem, query, q, memory):
                continue
            solutions += 1
            seconds = _seconds_between(problem, seed, q)
            if seconds < nearest:
                nearest = seconds
                _accept(query, q, metres, radians)
            if solutions == problem.candidates:
                break
        elif solutions == 0 and _improves(problem, query, q, metres, radians, memory):
            error[0], error[1] = metres, radians
    return solutions > 0


@inlined
def _wrap(angle):
    """Return the angle in (-pi, pi], unchanged to the bit if it is there."""
    if -np.pi < angle <= np.pi:
        return angle
    wrapped = np.pi - (np.pi - angle) % (2.0 * np.pi)
    return wrapped if wrapped > -np.pi else np.pi


@inlined
def _close_enough(problem, metres, radians):
    # In this form, errors that are not finite are no solution.
    return metres <= problem.accept_position and radians <= problem.accept_rotation


@inlined
def _free(problem, query, q, memory):
    """Return whether joint positions are free of collisions and can be held."""
    model, scratch = problem.collision, memory.collision
    if _collides(model, problem.check_collision, q, scratch, *query.around):
        return False
    return len(problem.load) == 0 or not overloads(model.tree, problem.load, q, scratch)


@inner
def _collides(model, with_itself, q, scratch, pose, size, cylinder):
    if with_itself and touches_itself(model, q, scratch):
        return True
    if len(pose) == 0:
        return False
    if not with_itself:
        place_shapes(model, q, scratch)
    around = bounds(model, True, scratch)
    return touches_solids(model, True, around, pose, size, cylinder, scratch)


@inlined
def _grow(size, clearance, out):
    for k in range(len(size)):
        by = 0.0 if is_empty(size[k]) else clearance
        out[k, 0], out[k, 1] = size[k, 0] + by, size[k, 1] + by
        out[k, 2], out[k, 3] = size[k, 2] - by, size[k, 3] + by


@inlined
def _improves(problem, query, q, metres, radians, memory):
    """Return whether an attempt is the closest so far, free of collisions and can be held."""
    closer = _cost(problem, metres, radians) < _cost(problem, query.error[0], query.error[1])
    return closer and _free(problem, query, q, memory)


@inlined
def _cost(problem, metres, radians):
    return square(metres) + square(problem.descent.rotation_weight * radians)


@inlined
def _rank_library(problem, target, scores, order):
    """Write the library entries whose EE is nearest to the target, nearest first."""
    features = problem.features
    copy_row(features[0], scores)
    for k in range(3):
        factor = np.float32(target[1][k])
        for j in range(len(scores)):
            scores[j] += features[1 + k, j] * factor
    for k in range(9):
        factor = np.float32(target[0][k // 3, k % 3])
        for j in range(len(scores)):
            scores[j] += features[4 + k, j] * factor
    kept = 0
    for j in range(len(scores)):
        if kept == len(order) and scores[j] >= scores[order[kept - 1]]:
            continue
        rank = min(kept, len(order) - 1)
        kept = min(kept + 1, len(order))
        while rank > 0 and scores[order[rank - 1]] > scores[j]:
            order[rank] = order[rank - 1]
            rank -= 1
        order[rank] = j


@inlined
def _out_of_reach(problem, target):
    """Return whether the target would bring the last joint outside the ball `reach`."""
    orientation, squared, lever = problem.chain.ee_rotation, 0.0, 0.0
    for i in range(3):
        joint = target[1][i]
        for k in range(3):
            for m in range(3):
                joint -= target[0][i, k] * orientation[m, k] * problem.chain.ee_offset[m]
        squared += square(joint - problem.reach[i])
        lever += square(problem.chain.ee_offset[i])
    pose_tolerance = problem.accept_position + problem.accept_rotation * math.sqrt(lever)
    return squared > square(problem.reach[3] + pose_tolerance)


@inlined
def _seconds_between(problem, start, end):
    longest = 0.0
    for j in range(len(start)):
        move = end[j] - start[j]
        if problem.continuous[j]:
            move = _wrap(move)
        longest = max(longest, abs(move) / problem.velocity[j])
    return longest
