"""The base path planner: drives the base along a path that is planned for the whole EE motion."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.control.drive import base_velocity
from kinfeas.control.observation import HORIZON
from kinfeas.core.backend import RealTimeBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, distance, integrate, twist_between, wrap, yaw
from kinfeas.kinematics.base_path import BasePathPlanner
from kinfeas.robots.robot import Base, joint_displacement

_LENGTH, _FINE = 15.0, 0.05
"""Length of EE motion that is planned for, and distance of its samples, metres."""

_METRES, _RADIANS = 0.2, 0.3
"""Largest distance of the EE poses for which base poses are sought."""

_SPEED, _TURN_SPEED = 0.1, 0.1
"""Speed of EE motions that is planned for, m/s and rad/s."""

_LEVER = 0.5
"""Metres that count as a change of a quaternion by 1 where the EE's place on the path is sought."""

_LOST, _PATIENCE = 0.15, 2.0
"""Metres off the path after which a new one is planned, and seconds between plans."""


@dataclass
class _Path:
    """The path of one robot.

    Attributes:
        subgoal: Sub-goal that it leads to.
        places: Positions and quaternions of the EE on it, shape (k, 7), metres.
        joints: Arms on it, shape (k, j); None without a path.
        at: Place on it now, 0 to k - 1.
        age: Seconds since it was planned.
    """

    subgoal: int
    places: Array
    joints: Array | None
    at: float = 0.0
    age: float = 0.0

    def advance(self, pose: Array) -> None:
        """Move on to an EE pose, shape (7,)."""
        first = int(self.at)
        begin, end = self.places[first : first + 3], self.places[first + 1 : first + 4]
        begin = begin[: len(end)]
        if len(end):
            place, way = _comparable(pose, begin[0]), end - begin
            share = np.sum((place - begin) * way, axis=1)
            share = np.clip(share / np.maximum(np.sum(way * way, axis=1), 1e-12), 0.0, 1.0)
            off = np.linalg.norm(begin + share[:, np.newaxis] * way - place, axis=1)
            best = int(off.argmin())
            self.at = max(self.at, first + best + float(share[best]))


class BasePathFilter:
    """Replaces the policy's commands by those along a base path that is planned ahead.

    When a sub-goal begins, base poses are sampled for EE poses along the motion and connected by
    dynamic programming: free of standing solids, with an IK solution, within velocity limits. Where
    no path is found, and among moving solids, the policy drives. No row depends on the others.
    """

    _loop: Any = None

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Plan for the motions of a loop; arguments as in `CommandFilter`."""
        *_, innermost = chain(loop.backend)
        for wrong, needs in (
            (loop.target_stream is not None, "EE motions with an end"),
            (loop.robot.base.drive != "omnidirectional", "an omnidirectional base"),
            (
                isinstance(innermost, RealTimeBackend),
                "a simulated world, since it plans for seconds",
            ),
        ):
            if wrong:
                raise KinfeasError(f"the filter base_path needs {needs}")
        if self._loop is not loop:
            self._loop, self._planner = loop, BasePathPlanner(loop.solver)
            self._paths: dict[int, _Path] = {}
        for row in rows.tolist():
            self._paths.pop(row, None)

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands along the paths; arguments as in `CommandFilter`."""
        loop, subgoal = self._loop, self._loop.sequence.subgoal.tolist()
        current = {r: p.subgoal for r, p in self._paths.items()}
        due = [row for row, one in enumerate(subgoal) if current.get(row) != one]
        if due:
            self._plan(due)
        paths = {
            r: path for r in range(len(command)) if (path := self._paths[r]).joints is not None
        }
        if not paths:
            return command
        rows, planned = list(paths), policy_input.planned
        for row, path in paths.items():
            path.advance(planned[row])
        arms = np.stack([self._arm_on(path) for path in paths.values()])
        base = policy_input.base_pose[rows]
        way = self._planner.base_at(planned[rows], arms)
        way -= np.column_stack([base[:, :2], yaw(base)])
        way[:, 2] = wrap(way[:, 2])
        for path, off in zip(paths.values(), np.linalg.norm(way[:, :2], axis=1), strict=True):
            path.age += loop.dt
            if off > _LOST and path.age > _PATIENCE:
                path.subgoal = -1
        command = command.copy()
        command[rows] = _toward(loop.robot.base, base, way)
        return command

    def _plan(self, rows: list[int]) -> None:
        loop, base = self._loop, self._loop.state.base_pose
        ahead = loop.sequence.ahead(np.arange(0.0, _LENGTH, _FINE))
        solids = loop.obstacles.after(0.0)
        moving = np.zeros(len(base), dtype=np.bool_) if solids is None else loop.obstacles.moving
        for row in rows:
            poses, seconds = _stations(ahead[row])
            around = None if solids is None else solids.of(np.array([row]))
            joints = None
            if len(poses) > 1 and not moving[row]:
                arm = loop.joint_command[row]
                joints = self._planner.plan(poses, seconds, base[row], arm, around)
            places = [_comparable(poses[0], poses[0])]
            for pose in poses[1:]:
                places.append(_comparable(pose, places[-1]))
            self._paths[row] = _Path(int(loop.sequence.subgoal[row]), np.array(places), joints)

    def _arm_on(self, path: _Path) -> Array:
        """Return the arm at the present place on a path, shape (j,)."""
        assert path.joints is not None
        k = min(int(path.at), len(path.joints) - 2)
        begin, end = path.joints[k : k + 2]
        arm: Array = begin + (path.at - k) * joint_displacement(self._loop.robot, begin, end)
        return arm


def _stations(ahead: Array) -> tuple[Array, Array]:
    """Return EE poses at even steps along a motion, (k, 7), and the seconds between them."""
    metres, radians = distance(ahead[:-1], ahead[1:])
    steps = np.concatenate([[0.0], np.cumsum(np.maximum(metres / _METRES, radians / _RADIANS))])
    at = np.linspace(0.0, steps[-1], int(np.ceil(steps[-1])) + 1)
    before = np.clip(np.searchsorted(steps, at, side="right") - 1, 0, len(ahead) - 2)
    way = twist_between(ahead[before], ahead[before + 1], 1.0)
    share = (at - steps[before]) / np.maximum(steps[before + 1] - steps[before], 1e-9)
    poses = integrate(ahead[before], way * share[:, np.newaxis], 1.0)
    metres, radians = distance(poses[:-1], poses[1:])
    return poses, np.maximum(metres / _SPEED, radians / _TURN_SPEED)


def _comparable(pose: Array, before: Array) -> Array:
    """Return position and scaled quaternion of a pose, its sign that of the place before, (7,)."""
    place = pose * np.array([1.0, 1.0, 1.0, *[_LEVER] * 4])
    if place[3:] @ before[3:] < 0.0:
        place[3:] *= -1.0
    return place


def _toward(base: Base, base_pose: Array, way: Array) -> Array:
    """Return the actions that drive bases by x, y and heading, (n, 3), within `HORIZON`."""
    twist = np.zeros((len(way), 6))
    twist[:, [0, 1, 5]] = way / HORIZON
    velocity = base_velocity(base, base_pose, twist, HORIZON)
    planar, turn = velocity[:, :2] / base.max_velocity, velocity[:, 2:] / base.max_rotation
    planar /= np.maximum(np.linalg.norm(planar, axis=1, keepdims=True), 1.0)
    return np.concatenate([planar, np.clip(turn, -1.0, 1.0)], axis=1)
