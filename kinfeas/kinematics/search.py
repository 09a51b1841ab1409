"""The search of IK: descents from the seed, then from a library of configurations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import copy_row, inlined, inner, kernel, square
from kinfeas.core.solid_kernels import is_empty
from kinfeas.core.spatial import Array
from kinfeas.kinematics.descent import Descent, descend, make_scratch, measure
from kinfeas.kinematics.forward import Chain, place_chain, write_matrix
from kinfeas.kinematics.gravity import overloads
from kinfeas.kinematics.self_collision import (
    CollisionModel,
    make_collision_scratch,
    place_shapes,
    touches_itself,
)
from kinfeas.kinematics.solids import bounds, touches_solids


class SearchSettings(NamedTuple):
    """Settings of the search."""

    aim: float = 0.2  # fraction of the tolerances at which a descent ends early
    warm_cost: float = 0.3**2  # squared error up to which descents begin at the seed, m^2
    restarts: int = 6  # after which the search ends if all of them had ...
    hopeless_cost: float = 0.02**2  # ... a larger squared error, m^2


SEARCH = SearchSettings()

GUIDED, CENTRED, NEAR, JUMP, WIDE = range(5)
"""Descents within `max_joint_step` of the seed: towards the guide, centring the joints or not; and
to anywhere: from the guide, and from the seed."""


class Problem(NamedTuple):
    """Constants of a robot's search.

    Arms move towards the middles by `centering` times the root of the distance, a fraction of
    `max_joint_step`.
    """

    chain: Chain  # from base to EE, driven by v variables
    descent: Descent  # options of a descent
    collision: CollisionModel  # self-collision model
    check_collision: bool  # whether self-collision is checked
    load: Array  # of a `GravityModel`, shape (m, 6); (0, 6) if any posture can be held
    lower: Array  # joint limits, shape (v,); -inf for continuous joints
    upper: Array  # same, +inf for continuous joints
    velocity: Array  # joint velocity limits, shape (v,)
    continuous: NDArray[np.bool_]  # whether joints are continuous, shape (v,)
    middle: Array  # middles of the joint ranges, shape (v,)
    centering: Array  # pull towards the middles, shape (v,); (0,) for none
    reach: Array  # centre and radius of a ball that contains the last joint, shape (4,), metres
    library: Array  # configurations to restart from, shape (l, v)
    features: NDArray[np.float32]  # for ranking these, shape (13, l); see `library_features`
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
    """Solve row by row; arguments as in `IkSolver.solve`, `max_joint_step` (0,) for none.

    `solids` are `SolidArrays`, from which arms keep a clearance, metres; those without solids may
    have fewer rows, as `guide` without any.

    `solution`, shape (n, v), has the seeds and receives the solutions, `feasible` whether there is
    one, `errors`, shape (n, 2), its errors or those of the closest attempt, metres and radians.
    """
    scratch = make_scratch(len(problem.chain.tree.variable), solution.shape[1])
    touching = make_collision_scratch(problem.collision)
    near = np.empty((6, len(max_joint_step)))
    order = np.empty(problem.restarts, dtype=np.intp)
    scores = np.empty(len(problem.library), dtype=np.float32)
    orientation = np.empty((3, 3))
    limits, (pose, size, cylinder) = (problem.lower, problem.upper), solids
    grown = np.empty(size.shape[1:])
    for i in range(len(solution)):
        write_matrix(targets[i], orientation)
        target = orientation, targets[i, :3]
        row = min(i, len(pose) - 1)
        _grow(size[row], clearance, grown)
        around = pose[row], grown, cylinder[row]
        if _solve_from_seed(
            problem, limits, target, max_joint_step, allow_reconfiguration, near,
            guide[i : i + 1], solution[i], errors[i], scratch, touching, around,
        ):  # fmt: skip
            feasible[i] = True
        elif not allow_reconfiguration or problem.restarts == 0 or _out_of_reach(problem, target):
            feasible[i] = False
        else:
            _rank_library(problem, target, scores, order)
            feasible[i] = _solve_from_library(
                problem, limits, target, solution[i], errors[i], order, scratch, touching, around
            )
        for j in range(solution.shape[1]):
            if feasible[i] and problem.continuous[j]:
                solution[i, j] = _wrap(solution[i, j])


@inlined
def _solve_from_seed(
    problem, limits, target, max_joint_step, allow_reconfiguration, near, guide, solution, error,
    scratch, touching, around,
):  # fmt: skip
    """Descend from the seed if it is near the target; return whether there is a solution.

    The first descents stay within `max_joint_step`, towards the guide if there is one, then with
    and without centring of the joints. There a joint of the seed beyond a limit may stay where it
    is, since it cannot jump. The last descents, if `allow_reconfiguration`, have the joint limits
    only: from the guide, then from the seed.
    """
    q, own = scratch.trial, limits
    if len(max_joint_step) > 0:
        own = near[4], near[5]
        for j in range(len(q)):
            own[0][j] = min(limits[0][j], solution[j])
            own[1][j] = max(limits[1][j], solution[j])
    _start(own, solution, q)
    place_chain(problem.chain, q, scratch.frames)
    cost, trace = 0.0, 0.0
    for i in range(3):
        cost += square(target[1][i] - scratch.frames.position[i])
        for k in range(3):
            trace += target[0][i, k] * scratch.frames.rotation[i, k]
    cost += square(problem.descent.rotation_weight) * (3.0 - trace)
    error[0], error[1] = measure(target, scratch)
    if cost > SEARCH.warm_cost:
        return False
    metres_here, radians_here = error[0], error[1]
    first = WIDE if len(max_joint_step) == 0 else NEAR if len(problem.centering) == 0 else CENTRED
    if first != WIDE and len(guide) > 0 and not math.isnan(guide[0, 0]):
        first = GUIDED
    if first != WIDE:
        for j in range(len(q)):
            near[0, j] = max(own[0][j], q[j] - max_joint_step[j])
            near[1, j] = min(own[1][j], q[j] + max_joint_step[j])
    for attempt in range(first, WIDE + 1 if allow_reconfiguration else JUMP):
        if attempt == CENTRED and len(problem.centering) == 0:
            continue
        if attempt == JUMP and first != GUIDED:
            continue
        bounds = limits if attempt >= JUMP else (near[0], near[1])
        if attempt == GUIDED:
            _go_to_guide(problem, max_joint_step, guide[0], near, q)
            bounds = near[2], near[3]
            place_chain(problem.chain, q, scratch.frames)
        elif attempt == CENTRED:
            _centre(problem, max_joint_step, q, scratch.pull)
        elif attempt == JUMP:
            _start(limits, guide[0], q)
            place_chain(problem.chain, q, scratch.frames)
        metres, radians = descend(problem.chain, problem.descent, bounds, target, q, scratch)
        # A guide must not cost accuracy.
        scale = SEARCH.aim if attempt == GUIDED else 1.0
        if _close_enough(problem, metres / scale, radians / scale):
            if _free(problem, q, touching, around):
                error[0], error[1] = metres, radians
                copy_row(q, solution)
                return True
        elif _improves(problem, metres, radians, error, q, touching, around):
            error[0], error[1] = metres, radians
        if attempt <= CENTRED or attempt == JUMP:
            _start(own, solution, q)
            place_chain(problem.chain, q, scratch.frames)
    # With a pose tolerance, the seed itself may be a solution that every descent has left.
    if not _close_enough(problem, metres_here, radians_here):
        return False
    _start(own, solution, q)
    if not _free(problem, q, touching, around):
        return False
    error[0], error[1] = metres_here, radians_here
    copy_row(q, solution)
    return True


@inlined
def _start(limits, seed, q):
    for j in range(len(q)):
        q[j] = min(max(seed[j], limits[0][j]), limits[1][j])


@inlined
def _go_to_guide(problem, max_joint_step, guide, near, q):
    """Move `q` to the guide within the first limits of `near`; write those around it, too."""
    for j in range(len(q)):
        move = guide[j] - q[j]
        move = _wrap(move) if problem.continuous[j] else move
        q[j] = min(max(q[j] + move, near[0, j]), near[1, j])
        near[2, j] = max(near[0, j], q[j] - max_joint_step[j])
        near[3, j] = min(near[1, j], q[j] + max_joint_step[j])


@inlined
def _centre(problem, max_joint_step, q, pull):
    """Write the pull of the joints towards the middles of their ranges, not beyond them."""
    for j in range(len(q)):
        away = q[j] - problem.middle[j]
        length = problem.centering[j] * math.sqrt(abs(away)) * max_joint_step[j]
        pull[j] = -math.copysign(min(length, abs(away)), away)


@inlined
def _solve_from_library(problem, limits, target, solution, error, order, scratch, touching, around):
    """Descend from library entries; keep the solution nearest to the seed."""
    q, seed = scratch.trial, scratch.seed
    copy_row(solution, seed)
    closest = _cost(problem, error[0], error[1])
    nearest, solutions = np.inf, 0
    for attempt in range(len(order)):
        if attempt >= SEARCH.restarts and closest > SEARCH.hopeless_cost:
            break
        copy_row(problem.library[order[attempt]], q)
        place_chain(problem.chain, q, scratch.frames)
        metres, radians = descend(problem.chain, problem.descent, limits, target, q, scratch)
        closest = min(closest, _cost(problem, metres, radians))
        if _close_enough(problem, metres, radians):
            if not _free(problem, q, touching, around):
                continue
            solutions += 1
            seconds = _seconds_between(problem, seed, q)
            if seconds < nearest:
                nearest = seconds
                error[0], error[1] = metres, radians
                copy_row(q, solution)
            if solutions == problem.candidates:
                break
        elif solutions == 0 and _improves(problem, metres, radians, error, q, touching, around):
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
def _free(problem, q, touching, around):
    if _collides(problem.collision, problem.check_collision, q, touching, *around):
        return False
    return len(problem.load) == 0 or not overloads(
        problem.collision.tree, problem.load, q, touching
    )


@inner
def _collides(collision, with_itself, q, touching, pose, size, cylinder):
    if with_itself and touches_itself(collision, q, touching):
        return True
    if len(pose) == 0:
        return False
    if not with_itself:
        place_shapes(collision, q, touching)
    around = bounds(collision, True, touching)
    return touches_solids(collision, True, around, pose, size, cylinder, touching)


@inlined
def _grow(size, clearance, out):
    for k in range(len(size)):
        by = 0.0 if is_empty(size[k]) else clearance
        out[k, 0], out[k, 1] = size[k, 0] + by, size[k, 1] + by
        out[k, 2], out[k, 3] = size[k, 2] - by, size[k, 3] + by


@inlined
def _improves(problem, metres, radians, error, q, touching, around):
    """Return whether an attempt is the closest so far, free of collisions and can be held."""
    closer = _cost(problem, metres, radians) < _cost(problem, error[0], error[1])
    return closer and _free(problem, q, touching, around)


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
