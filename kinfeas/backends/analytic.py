"""The analytic world: commands are carried out exactly and at once."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, ObstacleDistances, RobotState, Scan
from kinfeas.core.motion import Rows
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array, integrate
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.sensing import base_obstacles, base_prisms, scan
from kinfeas.robots.robot import Robot


class AnalyticBackend(Backend):
    """n robots without dynamics: bases integrate their twists, arms jump to their targets."""

    solids: MovingSolids

    def __init__(self, robot: Robot | None = None) -> None:
        """Make an empty world; without `robot` it measures no distances to obstacles."""
        self._prisms = None if robot is None else base_prisms(build_collision_model(robot))
        self.state = RobotState(np.empty((0, 7)), np.empty((0, 0)))
        self.solids, self.scanner, self.resumable = MovingSolids(), self, self
        self.obstacles = None if robot is None else self

    def place_solids(self, solids: Solids | None, env_ids: Rows) -> None:
        """Put solids around robots; arguments as in `Backend`."""
        self.solids.place(solids, env_ids, len(self.state.base_pose))

    def scan(self) -> Scan:
        """Return the ranges to solids around the bases."""
        return Scan(scan(self.solids.after(), self.state.base_pose))

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return the solids near the bases, as in `ObstacleSensor`."""
        assert self._prisms is not None
        base = self.state.base_pose
        solids = self.solids.after() or Solids.empty(len(base))
        return base_obstacles(self._prisms, base, solids, within)

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: Rows | None = None
    ) -> RobotState:
        """Place robots and return the state of all n; shapes as in `Backend`."""
        if env_ids is None:
            self.state = RobotState(np.array(base_pose), np.array(joint_positions))
        else:
            base, joints = self.state.base_pose.copy(), self.state.joint_positions.copy()
            base[env_ids], joints[env_ids] = base_pose, joint_positions
            self.state = RobotState(base, joints)
        return self.state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Move all robots for `dt` seconds and return their state; shapes as in `Backend`."""
        base = integrate(self.state.base_pose, base_twist, dt)
        self.state = RobotState(base, np.array(joint_targets))
        self.solids.step(dt)
        return self.state

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return base poses, joint positions and solids of all robots."""
        base, joints = self.state.base_pose, self.state.joint_positions
        return {"base_pose": base, "joint_positions": joints, **self.solids.snapshot()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Restore a state that `snapshot` returned, and return the measured state."""
        self.state = RobotState(snapshot["base_pose"].copy(), snapshot["joint_positions"].copy())
        self.solids.restore(snapshot, len(self.state.base_pose))
        return self.state

    def close(self) -> None:
        """Do nothing."""
