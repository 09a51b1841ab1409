"""Goal reaching among random solids that stand or move."""

from dataclasses import dataclass, field, replace

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Count, Distance, Fraction, NotNegative
from kinfeas.core.solids import MOST_SOLIDS, Solids
from kinfeas.core.spatial import compose
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.clutter import SMALLEST, Clutter, free_places, touches_robot
from kinfeas.tasks.ggr import GoalReaching
from kinfeas.tasks.task import MotionSpec, named

_ROUNDS = 200  # draws of an episode before an error
_MOMENTS = 16  # times at which the positions of moving solids are checked


@dataclass(frozen=True)
class ReachingAmongSolids(GoalReaching, Clutter):
    """Reach a random EE pose among boxes and cylinders on the floor.

    The grid of solids is around the middle between start and goal. Those that would touch the robot
    at its start, or the goal, are left out, and goals without room for the base are drawn again.
    The `places` nearest solids remain. Other attributes are those of `Clutter`.
    """

    name: str = "ggr_obstacles"
    motion: MotionSpec = field(default_factory=lambda: MotionSpec("whole_body"))
    distance: tuple[Distance, Distance] = (0.5, 8.0)
    places: Count = MOST_SOLIDS  # largest number of solids
    extent: Distance = 14.0
    spacing: Distance = 1.75
    jitter: NotNegative = 0.4375
    footprint: tuple[Distance, Distance] = (1.5, 1.0)
    start_clearance: Distance = 0.7  # free radius around base and EE at first, metres
    goal_clearance: Distance = 0.25  # free radius around the EE at the goal, metres
    empty: Fraction = 0.0  # fraction of episodes without any solid

    def __post_init__(self) -> None:
        GoalReaching.__post_init__(self)
        Clutter.__post_init__(self)
        if self.places > MOST_SOLIDS or not 0.5 <= self.spacing <= self.extent <= 100.0:
            raise ValueError(
                f"'places' must be at most {MOST_SOLIDS}, 'spacing' at least 0.5 m and 'extent' "
                "from 'spacing' to 100 m"
            )
        if min(self.footprint) < SMALLEST:
            raise ValueError(f"'footprint' must be at least {SMALLEST} m")

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode with its solids."""
        if self.empty and rng.random() < self.empty:
            return replace(super().sample(solver, rng), solids=Solids.empty(1, self.places))
        for _ in range(_ROUNDS):
            start = super().sample(solver, rng)
            solids = self._solids(solver, start, rng)
            if len(free_places(solver, start.target_poses[0], solids)):
                return replace(start, solids=solids.repeated(1))
        raise KinfeasError(f"task {self.name!r}: {_ROUNDS} draws left no room for the base")

    def _solids(self, solver: IkSolver, start: Start, rng: np.random.Generator) -> Solids:
        """Return the solids of an episode at moments of their motion, a row each, start first."""
        goal = start.target_poses[0]
        drawn = self.draw_solids(rng, goal[:2] / 2.0)
        at_start = touches_robot(solver, start, drawn)
        ee = compose(start.base_pose, forward(solver.chain, start.joint_positions))
        ends = np.stack([start.base_pose[:3], ee[:3], goal[:3]])
        near = drawn.gaps(ends[np.newaxis, :2])[0][0].min(axis=0) < self.start_clearance
        moments = _moments(drawn)
        gaps = moments.gaps(np.broadcast_to(goal[:3], (len(moments.pose), 1, 3)))
        at_goal = np.hypot(*gaps).min(axis=(0, 1)) < self.goal_clearance
        detour = np.linalg.norm(drawn.pose[0, :, :2] - ends[::2, np.newaxis, :2], axis=2).sum(0)
        cost = np.where(at_start | near | at_goal, np.inf, detour)
        order = np.argsort(cost, kind="stable")[: self.places]
        order = order[np.isfinite(cost[order])]
        n = len(moments.pose)
        return Solids.empty(n, self.places).put(np.arange(n), moments.only(order))


def _moments(solids: Solids) -> Solids:
    """Return one row of solids at moments until all have turned back once, a row each."""
    speed = np.linalg.norm(solids.velocity, axis=2)
    if not speed.any():
        return solids
    longest = np.max(solids.span / np.where(speed > 0.0, speed, np.inf))
    return solids.repeated(_MOMENTS).at(np.linspace(0.0, longest, _MOMENTS))


def ggr_obstacles(**parameters: object) -> ReachingAmongSolids:
    """Goal reaching among up to 64 solids that stand."""
    return named(ReachingAmongSolids, "ggr_obstacles", {}, parameters)


def ggr_dynamic(**parameters: object) -> ReachingAmongSolids:
    """Goal reaching among 16 solids that move to and fro, none of them a wall.

    The EE is as fast as the solids, so that the robot can give way.
    """
    moving = {"places": 16, "spacing": 2.8, "jitter": 0.7, "speed": (0.1, 0.15)}
    lower = {"walls": 0.0, "footprint": (0.8, 0.8)}
    fast = {"ramp": 1.0, "max_velocity": 0.2, "max_angular_velocity": 0.5}
    motion = {"generator": "whole_body", "parameters": fast}
    defaults = {**moving, **lower, "motion": motion}
    return named(ReachingAmongSolids, "ggr_dynamic", defaults, parameters)
