"""Beams: configurations of base and arm at one EE pose of a path, and those at the next.

A configuration of base and arm is called a robot here.
"""

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import (
    Array,
    compose,
    integrate,
    planar_pose,
    relative,
    twist_between,
    yaw,
)
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolution, IkSolver, spread_configurations
from kinfeas.kinematics.solids import base_collides, collides, in_base
from kinfeas.planning.proposals import propose
from kinfeas.robots.robot import joint_displacement


@dataclass(frozen=True)
class BeamSettings:
    """Settings of the beams."""

    beam: int = 150  # robots that are kept at each pose
    commands: int = 900  # base commands that the robots of a beam try together
    robot_commands: int = 200  # largest number of commands that one robot tries
    noise: float = 0.5  # largest difference of half of the commands from the EE's velocity
    configurations: int = 2  # arm configurations to which each robot tries to jump
    velocity: float = 0.3  # largest speed of the base, m/s
    rotation: float = 0.5  # largest angular speed of the base, rad/s
    base_fraction: float = 0.8  # fraction of the base's limits used; the rest is for control
    arm_fraction: float = 0.7  # fraction of the arm's velocity limits used, likewise
    cell: float = 0.12  # size of a cell, of whose robots a beam keeps the best, metres
    heading: float = math.pi / 8.0  # size of a cell in heading, radians
    elbows: int = 4  # number of cells in the elbow's range
    cell_robots: int = 4  # robots of a cell that try IK
    centred: float = 0.6  # fraction of the joint ranges that costs nothing
    limit_cost: float = 5.0  # cost of the squared rest of the range
    effort_cost: float = 0.1  # cost of the squared base command
    change_cost: float = 0.3  # cost of the squared change of the base command
    sensitive_cost: float = 0.3  # cost of the logarithm of `Proposal.sensitivity`
    farthest: float = 1.3  # largest `Proposal.motion` for which IK is tried
    tried: int = 150  # robots that try IK
    joint_margin: float = 0.05  # distance from joint limits, as a fraction of half the range
    clearance: float = 0.01  # distance of the robot's shapes from each other, metres
    margin_cost: float = 5.0  # cost of arms that do not keep these two distances
    base_clearance: float = 2.0  # distance of bases from solids, in units of `ik.solid_clearance`
    error_cost: float = 100.0  # cost of the error of arms with a pose tolerance, 1/m
    off_metres: float = 0.03  # deviation of a base that arms should compensate, x and y, metres
    off_radians: float = 0.04  # deviation of a base that arms should compensate, yaw, radians
    off_seconds: float = 1.0  # time in which arms should compensate it, seconds
    off_cost: float = 60.0  # cost of an arm that cannot compensate it in any direction
    memory: float = 0.8  # fraction of the costs that counts at the next pose


SETTINGS = BeamSettings()

_BETWEEN = (0.125, 0.25, 0.375, 0.625, 0.75, 0.875)
"""Fractions of the time to the next pose at which bases must not touch solids either."""

_CELLS = 1e4  # largest number of cells along an axis, so that indices of cells are exact floats
_AHEAD, _ASIDE = np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]]) * SETTINGS.off_metres
_OFF = planar_pose(_AHEAD, _ASIDE, np.sign(_AHEAD) * SETTINGS.off_radians)
"""Deviations of a base that arms should compensate, as poses in the base frame, shape (4, 7)."""


@dataclass(frozen=True)
class Beam:
    """Robots with their EE at one pose."""

    base: Array  # world poses of the base, shape (m, 7)
    joints: Array  # arm joints, shape (m, j)
    command: Array  # base commands that led here, shape (m, a)
    cost: Array  # cost of the path, shape (m,)
    parent: NDArray[np.intp]  # index of the preceding robot in the previous beam, shape (m,)

    def of(self, rows: NDArray[np.intp]) -> "Beam":
        """Return some of the robots."""
        return Beam(*(values[rows] for values in vars(self).values()))


class BeamExpander:
    """Finds the beam at the next EE pose.

    Every robot of a beam tries random base commands. For those that the Jacobian predicts to be
    best, IK moves the arm within its velocity limits, and the best robot of each cell goes on. Arms
    far from joint limits, self-collision and singularities cost less, as do arms that also reach
    the pose from nearby base poses, since they can compensate deviations of the base.
    """

    def __init__(self, solver: IkSolver) -> None:
        self.robot = robot = solver.robot
        self._width = 1
        self._anywhere, self.solver = solver, solver.local()
        self._careful = solver.local(
            joint_margin=SETTINGS.joint_margin, self_clearance=SETTINGS.clearance
        )
        limits = [robot.base.max_velocity, robot.base.max_rotation]
        fastest = np.array([SETTINGS.velocity, SETTINGS.rotation])
        fastest = np.minimum(fastest / limits, SETTINGS.base_fraction)
        self._fastest = np.repeat(fastest, [command_size(robot.base) - 1, 1])
        lower, upper = robot.finite_joint_limits
        self._middle, self._half = (lower + upper) / 2.0, np.maximum((upper - lower) / 2.0, 1e-9)
        self._bounded = np.isfinite(np.subtract(*robot.joint_limits))
        self._elbow = max(len(robot.arm) - 4, 0)

    def wider(self, width: int) -> "BeamExpander":
        """Return an expander with `width` times as many commands, IK attempts and robots kept."""
        other = copy.copy(self)
        other._width = width
        return other

    def first(self, base_pose: Array, joints: Array) -> Beam:
        """Return a beam of one robot, its base at a world pose (7,), with arm joints (j,)."""
        command, cost = np.zeros((1, len(self._fastest))), np.zeros(1)
        parent = np.zeros(1, dtype=np.intp)
        return Beam(base_pose[np.newaxis], joints[np.newaxis], command, cost, parent)

    def moved(
        self,
        beam: Beam,
        target: Array,
        seconds: float,
        rng: np.random.Generator,
        solids: Solids | None,
    ) -> Beam:
        """Return the next beam: the best robots with their EE at a target after some seconds."""
        tried = self._proposed(beam, target, seconds, rng)
        arm = self._reached(self._careful, tried.joints, target, tried.base, seconds, solids)
        cost = tried.cost.copy()
        if (failed := np.flatnonzero(~arm.feasible)).size:
            joints, base = tried.joints[failed], tried.base[failed]
            arm.put(failed, self._reached(self.solver, joints, target, base, seconds, solids))
            cost[failed] += SETTINGS.margin_cost
        cost += self._limit_cost(arm.joint_positions)
        allowed = self.solver.options.position_tolerance
        cost += SETTINGS.error_cost * np.maximum(arm.position_error - allowed, 0.0)
        reached = replace(tried, joints=arm.joint_positions, cost=cost)
        reached = reached.of(np.flatnonzero(arm.feasible))
        best = self._best(reached, target)
        best = best.of(np.flatnonzero(self._passable(beam, best, target, seconds, solids)))
        return replace(best, cost=best.cost + self._off_cost(best, target, solids))

    def reconfigured(self, beam: Beam, target: Array, solids: Solids | None) -> Beam:
        """Return the robots of a beam, at its target, with arms in other configurations."""
        rows = np.arange(len(beam.cost)).repeat(SETTINGS.configurations)
        beam = replace(beam.of(rows), parent=rows)
        seeds = spread_configurations(self.robot, len(rows))
        among = None if solids is None else in_base(solids.repeated(len(rows)), beam.base)
        arm = self._anywhere.solve(relative(target, beam.base), seeds, solids=among)
        cost = beam.cost + self._limit_cost(arm.joint_positions)
        beam = replace(beam, joints=arm.joint_positions, cost=cost)
        return self._best(beam.of(np.flatnonzero(arm.feasible)), target)

    def _proposed(
        self, beam: Beam, target: Array, seconds: float, rng: np.random.Generator
    ) -> Beam:
        """Return robots, with their arms still as in the beam, that seem able to reach a target."""
        base, command = self.robot.base, self._commands(beam, rng)
        step = SETTINGS.arm_fraction * seconds * self.robot.max_joint_velocity
        limits, near = (base.max_velocity, base.max_rotation), command.shape[1] // 2
        proposal = propose(
            self.solver.chain, beam.base, beam.joints, command, near, target, step, limits, seconds
        )
        parent, tried = np.nonzero(proposal.motion < SETTINGS.farthest)
        command = command[parent, tried]
        cost = SETTINGS.memory * beam.cost[parent]
        cost += SETTINGS.effort_cost * np.square(command).sum(axis=1)
        cost += SETTINGS.change_cost * np.square(command - beam.command[parent]).sum(axis=1)
        cost += SETTINGS.sensitive_cost * np.log(proposal.sensitivity)[parent]
        poses = planar_pose(*proposal.base[parent, tried].T)
        expected = cost + self._limit_cost(proposal.joints[parent, tried])
        rows = _cheapest(_cells(poses, target), expected, SETTINGS.cell_robots)
        rows = rows[np.argsort(expected[rows], kind="stable")[: self._width * SETTINGS.tried]]
        parent = parent[rows]
        return Beam(poses[rows], beam.joints[parent], command[rows], cost[rows], parent)

    def _off_cost(self, beam: Beam, target: Array, solids: Solids | None) -> Array:
        """Return the cost of arms that cannot compensate deviations of the base."""
        base = compose(beam.base, _OFF[:, np.newaxis]).reshape(-1, 7)
        joints = np.tile(beam.joints, (len(_OFF), 1))
        arm = self._reached(self.solver, joints, target, base, SETTINGS.off_seconds, solids)
        failed: Array = np.mean(~arm.feasible.reshape(len(_OFF), -1), axis=0)
        return SETTINGS.off_cost * failed

    def _limit_cost(self, joints: Array) -> Array:
        """Return the cost of arms near their joint limits."""
        off = np.where(self._bounded, np.abs(joints - self._middle) / self._half, 0.0)
        beyond = np.maximum(off - SETTINGS.centred, 0.0).max(axis=1)
        cost: Array = SETTINGS.limit_cost * np.square(beyond)
        return cost

    def _driven(self, beam: Beam, command: Array, seconds: float) -> Array:
        """Return the bases after some time, shape (m, 7), along the chords of their arcs."""
        twist = base_twist(self.robot.base, beam.base, command, seconds / 2.0)
        return integrate(beam.base, twist, seconds)

    def _reached(
        self,
        solver: IkSolver,
        joints: Array,
        target: Array,
        base: Array,
        seconds: float,
        solids: Solids | None,
    ) -> IkSolution:
        """Return IK solutions for a target that arms reach in some time from joints (m, j)."""
        among = None if solids is None else solids.repeated(len(base))
        arm = solver.solve(
            relative(target, base),
            joints,
            SETTINGS.arm_fraction * seconds * self.robot.max_joint_velocity,
            allow_reconfiguration=False,
            solids=None if among is None else in_base(among, base),
        )
        if among is not None:
            touches = collides(solver.collision, arm.joint_positions, base, self._around(among))
            arm.feasible[touches[:, 0]] = False
        return arm

    def _around(self, solids: Solids) -> Solids:
        """Return the solids that bases must not touch, wider by their clearance."""
        clearance = SETTINGS.base_clearance * self.solver.options.solid_clearance
        return solids.wider(clearance, clearance) if clearance else solids

    def _passable(
        self, beam: Beam, best: Beam, target: Array, seconds: float, solids: Solids | None
    ) -> NDArray[np.bool_]:
        """Return which of the best robots, (m,), also reach the pose halfway to the target.

        Their bases must not touch solids on the way.
        """
        before = beam.of(best.parent)
        displacement = joint_displacement(self.robot, before.joints, best.joints)
        first = compose(beam.base[:1], forward(self.solver.chain, beam.joints[:1]))[0]
        halfway = integrate(first, twist_between(first, target, 1.0), 0.5)
        base = self._driven(before, best.command, seconds / 2.0)
        arm = self._reached(
            self.solver, before.joints + displacement / 2.0, halfway, base, seconds / 4.0, solids
        )
        passed = np.multiply.outer((0.25, 0.75), displacement) + before.joints
        if solids is not None:
            around = self._around(solids)
            for part in _BETWEEN:
                base = self._driven(before, best.command, part * seconds)
                touches = base_collides(self.solver.collision, base, around.repeated(len(base)))
                arm.feasible[touches] = False
        return arm.feasible & self.solver.admissible(passed).all(axis=0)

    def _commands(self, beam: Beam, rng: np.random.Generator) -> Array:
        """Return the commands that each robot tries, shape (m, t, a).

        The first is the robot's last command. The second half is noise, to which `propose` adds
        the velocity of the EE.
        """
        commands = self._width * SETTINGS.commands
        tries = min(commands // len(beam.cost), SETTINGS.robot_commands)
        shape = len(beam.cost), tries, len(self._fastest)
        command = rng.uniform(-self._fastest, self._fastest, shape)
        command[:, 0], near = beam.command, tries // 2
        command[:, near:] *= SETTINGS.noise * rng.random((len(beam.cost), tries - near, 1))
        return command

    def _best(self, beam: Beam, target: Array) -> Beam:
        """Return the best robot of each cell, in total at most as many as a beam keeps."""
        elbow = beam.joints[:, self._elbow] - self._middle[self._elbow]
        bent = elbow / self._half[self._elbow] * SETTINGS.elbows / 2.0
        cells = _cells(beam.base, target) + _CELLS**3 * np.floor(bent)
        best = beam.of(_cheapest(cells, beam.cost, 1))
        return best.of(np.argsort(best.cost, kind="stable")[: self._width * SETTINGS.beam])


def _cells(base: Array, target: Array) -> Array:
    """Return the indices of the cells of bases, shape (m, 7) -> (m,), around the EE's target."""
    x, y = np.floor((base[:, :2] - target[:2]) / SETTINGS.cell).T
    return x + _CELLS * y + _CELLS**2 * np.floor(yaw(base) / SETTINGS.heading)


def _cheapest(cells: Array, cost: Array, most: int) -> NDArray[np.intp]:
    """Return the indices of the `most` cheapest robots in each cell, given m cells and costs."""
    order = np.lexsort((cost, cells))
    begins = np.append(True, np.diff(cells[order]) != 0.0)
    rank = np.arange(len(order))
    return order[rank - np.maximum.accumulate(np.where(begins, rank, 0)) < most]
