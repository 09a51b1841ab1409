"""Paths of base and arm along given EE paths, by beam search."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, distance, yaw
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.beam import Beam, BeamExpander
from kinfeas.planning.placement import Postures

_STRAIGHT = 1e-6  # angle of an arc below which it counts as straight, radians
_ROUNDING = 1e-6  # seconds by which a motion time may be below that of a node


@dataclass(frozen=True)
class BasePathSettings:
    """Settings of the search for base paths."""

    metres: float = 0.07  # distance between successive EE poses that have a beam, metres
    radians: float = 0.07  # rotation between successive EE poses that have a beam, radians
    widths: tuple[int, ...] = (1, 2)  # widths of the beams of successive searches
    backtracking: tuple[int, ...] = (0, 4, 16)  # beams removed where no robot goes on, in order
    slow: float = 0.1  # fraction of the speed of the EE from there to where the search had ended
    solids: float = 2.0  # distance from the EE within which the robot may touch a solid, metres
    proposals: int = 256  # base poses tried at the EE pose where a search ends
    rest: float = 3.0  # longest part of an initial rest of the EE in which the robot moves, s


SETTINGS = BasePathSettings()


@dataclass(frozen=True)
class BasePath:
    """A path of base and arm along an EE path.

    Motion time runs at full speed of the EE: a time scale below 1 stretches it to real time.
    """

    ee: Array  # world poses of the EE, shape (k, 7)
    step: float  # motion time from one EE pose to the next, seconds
    begin: float  # motion time of the first EE pose, seconds
    seconds: Array  # motion times for which the path has base and arm, shape (m,)
    robot: Array  # x, y and unwrapped yaw of the base, then arm joints, shape (m, 3 + j)
    time_scale: Array  # fraction of its speed at which the EE moves until each of these times, (m,)

    @property
    def motion_time(self) -> Array:
        """Motion times of the EE poses, shape (k,), seconds."""
        time: Array = self.begin + self.step * np.arange(float(len(self.ee)))
        return time

    @property
    def complete(self) -> bool:
        """Whether the path reaches the end of the EE path."""
        return round((self.seconds[-1] - self.begin) / self.step) == len(self.ee) - 1

    def ee_at(self, seconds: float) -> Array:
        """Return the EE pose nearest to a motion time, shape (7,)."""
        number = round((seconds - self.begin) / self.step)
        pose: Array = self.ee[min(max(number, 0), len(self.ee) - 1)]
        return pose

    def robots_at(self, seconds: Array) -> Array:
        """Return base and arm at motion times (t,), shape (t, 3 + j), with bases on arcs."""
        if len(self.seconds) == 1:
            return self.robot.repeat(len(seconds), axis=0)
        last = np.searchsorted(self.seconds, seconds, "right").clip(1, len(self.seconds) - 1)
        begin, end = self.seconds[last - 1], self.seconds[last]
        fraction = np.ones(len(seconds))  # where an arm jumps, no time passes
        np.divide(seconds - begin, end - begin, out=fraction, where=end > begin)
        fraction = fraction.clip(0.0, 1.0)[:, np.newaxis]
        before, displacement = self.robot[last - 1], self.robot[last] - self.robot[last - 1]
        robots: Array = before + fraction * displacement
        robots[:, :2] = before[:, :2] + _along_arc(displacement[:, :3], fraction[:, 0])
        return robots

    def time_scale_at(self, seconds: float) -> float:
        """Return the fraction of its speed at which the EE moves at a motion time."""
        index = int(np.searchsorted(self.seconds, seconds + _ROUNDING))
        return float(self.time_scale[min(index, len(self.time_scale) - 1)])


class BasePathPlanner:
    """Finds paths of base and arm along EE paths.

    A beam search: the robots (configurations of base and arm) of the beam at one EE pose lead to
    the beam at the next. Where none goes on, the search goes back to earlier poses and slows the EE
    down from there. If this fails, a search with a wider beam begins, unless the EE reaches the
    next pose from no base. If this fails too, arms may jump, in partial paths only.
    """

    def __init__(self, solver: IkSolver) -> None:
        self._solver, self.robot = solver, solver.robot
        expander = BeamExpander(solver)
        self._expanders = [expander.wider(width) for width in SETTINGS.widths]

    @cached_property
    def _postures(self) -> Postures:
        return Postures(self._solver)

    def plan(
        self,
        base_pose: Array,
        joints: Array,
        ee: Array,
        step: float,
        begin: float,
        time_scale: float = 1.0,
        solids: Solids | None = None,
        *,
        rest: float = 0.0,
        partial: bool = False,
        seed: int = 0,
    ) -> BasePath | None:
        """Return a path, or None if none is found.

        Args:
            base_pose: World pose of the base now, shape (7,).
            joints: Arm joints now, shape (j,).
            ee: World poses of the EE, shape (k, 7), the first one now.
            step: Motion time from one EE pose to the next, seconds.
            begin: Motion time of the first EE pose, or of the end of the rest there, seconds.
            time_scale: Largest fraction of its speed at which the EE moves.
            solids: In the world, one row.
            rest: Motion time for which the EE rests at the first pose, seconds.
            partial: Whether arms may jump, and the path may end where no robot goes on, before the
                end of the EE path.
            seed: Seed of the random base commands that robots try.
        """
        resting = round(min(rest, SETTINGS.rest) / step)
        nodes = np.union1d(0, resting + _nodes(ee))
        begin, ee = begin - resting * step, np.vstack([ee[:1].repeat(resting, axis=0), ee])
        widest = self._expanders[-1]
        for expander in self._expanders:
            beam = expander.first(base_pose, joints)
            search = _Search(expander, ee, nodes, step / time_scale, solids, beam, resting, seed)
            complete = search.run(search.slow_down)
            if complete or expander is widest or not self._reaches(search.next_pose):
                break
        if partial and not search.complete:
            search.run(search.jump)
        if not search.complete and not (partial and len(search.beams) > 1):
            return None
        nodes = search.nodes[: len(search.beams)]
        robots = _traced(search.beams)
        turning = np.concatenate([[False, False, True], self.robot.continuous])
        robots[:, turning] = np.unwrap(robots[:, turning], axis=0)
        seconds = begin + step * nodes.astype(np.float64)
        scales = np.concatenate([[1.0], search.scales[nodes[:-1]]])
        return BasePath(ee, step, begin, seconds, robots, scales)

    def _reaches(self, pose: Array) -> bool:
        """Return whether the EE reaches a pose, (7,), from some base pose, ignoring solids."""
        numbers = 0, SETTINGS.proposals
        return len(self._postures.reaching(pose, numbers, restarts=False)[0]) > 0


class _Search:
    """A search for one path, with a beam at each node so far."""

    def __init__(
        self,
        expander: BeamExpander,
        ee: Array,
        nodes: NDArray[np.intp],
        step: float,
        solids: Solids | None,
        beam: Beam,
        resting: int,
        seed: int,
    ) -> None:
        self._expander, self._ee, self._step, self._resting = expander, ee, step, resting
        self._solids = None if solids is None else _near(solids, ee, SETTINGS.solids)
        self._rng = np.random.default_rng(seed)
        self.beams = [beam]
        self.nodes = nodes  # indices of EE poses; the same one twice where arms jump
        self.scales = np.ones(len(ee))  # fraction of its speed at which the EE moves from each pose

    @property
    def complete(self) -> bool:
        return len(self.beams) == len(self.nodes)

    @property
    def next_pose(self) -> Array:
        """The EE pose at which no robot goes on, shape (7,)."""
        pose: Array = self._ee[self.nodes[len(self.beams)]]
        return pose

    def run(self, go_back: Callable[[int], None]) -> bool:
        """Add beams, and go back where no robot goes on; return whether the last node has one."""
        backtracking = list(SETTINGS.backtracking)
        while not self.complete:
            if not self.add_beam():
                if not backtracking:
                    return False
                go_back(backtracking.pop(0))
        return True

    def add_beam(self) -> bool:
        """Add the next beam; return whether it has a robot."""
        k = len(self.beams)
        seconds, target = self._seconds(k), self._ee[self.nodes[k]]
        among = self._solids_at(seconds.sum())
        beam = self._expander.moved(self.beams[-1], target, float(seconds[-1]), self._rng, among)
        if len(beam.cost):
            self.beams.append(beam)
        return len(beam.cost) > 0

    def slow_down(self, back: int) -> None:
        """Go back by some nodes; slow the EE down, unless it rests, until the unreached node."""
        k = len(self.beams)
        first = max(k - 1 - back, 0)
        slow = np.arange(max(self.nodes[first], self._resting), self.nodes[k], 2)
        self.scales[slow] = SETTINGS.slow
        self.nodes, self.beams = np.union1d(self.nodes, slow), self.beams[: first + 1]

    def jump(self, back: int) -> None:
        """Go back by some nodes and let the arms jump there, if they can."""
        first = max(len(self.beams) - 1 - back, 0)
        node, among = self.nodes[first], self._solids_at(self._seconds(first).sum())
        beam = self._expander.reconfigured(self.beams[first], self._ee[node], among)
        if len(beam.cost):
            later = np.unique(self.nodes[self.nodes > node])
            self.nodes = np.concatenate([self.nodes[: first + 1], [node], later])
            self.beams = [*self.beams[: first + 1], beam]

    def _seconds(self, node: int) -> Array:
        """Return the durations between successive nodes up to a node, shape (node,), seconds."""
        seconds: Array = np.diff(self.nodes[: node + 1]) * self._step
        return seconds / self.scales[self.nodes[:node]]

    def _solids_at(self, seconds: float) -> Solids | None:
        return None if self._solids is None else self._solids.at(np.array([seconds]))


def _along_arc(whole: Array, fraction: Array) -> Array:
    """Return the x and y displacements of bases after fractions (t,) of their arcs, shape (t, 2).

    `whole` are the x, y and yaw displacements of the whole arcs, shape (t, 3).
    """
    angle = np.where(np.abs(whole[:, 2]) < _STRAIGHT, _STRAIGHT, whole[:, 2]) / 2.0
    turn, size = (fraction - 1.0) * angle, np.sin(fraction * angle) / np.sin(angle)
    cosine, sine = size * np.cos(turn), size * np.sin(turn)
    x, y = whole[:, 0], whole[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def _near(solids: Solids, ee: Array, reach: float) -> Solids | None:
    """Return the solids that a robot with its EE on the path may touch, if there are any."""
    away = solids.gaps(ee[np.newaxis, ::10, :3])[0][0].min(axis=0)
    near = solids.filled[0] & ((away < reach) | solids.velocity[0].any(axis=1))
    return solids.only(np.flatnonzero(near)) if near.any() else None


def path_length(ee: Array) -> Array:
    """Return the length of an EE path up to each pose, (k,), in units of the beams' distance."""
    metres, radians = distance(ee[:-1], ee[1:])
    parts = np.maximum(metres / SETTINGS.metres, radians / SETTINGS.radians)
    length: Array = np.append(0.0, np.cumsum(parts))
    return length


def _nodes(ee: Array) -> NDArray[np.intp]:
    """Return the indices of poses at about even distances, with the first and the last."""
    length = path_length(ee)[1:]
    even = np.linspace(0.0, length[-1], max(math.ceil(length[-1]), 1) + 1)[1:-1]
    return np.unique([0, *np.searchsorted(length, even) + 1, len(ee) - 1])


def _traced(beams: Sequence[Beam]) -> Array:
    """Return the path to the best robot of the last beam, shape (k, 3 + j)."""
    row, robots = int(beams[-1].cost.argmin()), []
    for beam in reversed(beams):
        x, y = beam.base[row, :2]
        robots.append([x, y, float(yaw(beam.base[row])), *beam.joints[row]])
        row = int(beam.parent[row])
    return np.array(robots[::-1])
