"""Goal reaching: random goals from random arm configurations, the task of training."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import check_ascending, check_name
from kinfeas.core.quantities import Distance, Metres
from kinfeas.core.spatial import Array, make_pose, planar_pose
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.task import MotionSpec, Subgoal, named, random_arm


@dataclass(frozen=True)
class GoalReaching:
    """Reach a random EE pose from a random arm configuration.

    The base begins at the origin with a random heading; the goal lies at a random bearing, with
    uniformly random roll, pitch and yaw. Heights are by default those of the robot's reach, or of
    its comfortable part with `restrict_start`. With `start: free`, arm configurations have no
    self-collision. With `start: any`, they may have one at the goal heights and, even with
    `restrict_start`, be at other heights without one, as the paper's program does for
    `ggr_restricted`.
    """

    name: str = "ggr"  # task name
    motion: MotionSpec = field(default_factory=MotionSpec)  # of the EE
    distance: tuple[Distance, Distance] = (1.0, 5.0)  # planar, of the goal from the base, metres
    heights: tuple[Metres, Metres] | None = None  # of the goal, metres
    restrict_start: bool = False  # whether the EE also starts within the goal heights
    start: Literal["free", "any"] = "free"

    def __post_init__(self) -> None:
        check_name(self.name)
        for name, bounds in (("distance", self.distance), ("heights", self.heights)):
            if bounds is not None:
                check_ascending(name, bounds)

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """The one motion, of the EE frame."""
        return (Subgoal(self.motion),)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis."""
        low, high = self._heights(solver)
        heading, bearing = rng.uniform(-np.pi, np.pi, 2)
        distance, height = rng.uniform(*self.distance), rng.uniform(low, high)
        goal = np.array([distance * np.cos(bearing), distance * np.sin(bearing), height])
        target = make_pose(goal, Rotation.from_euler("xyz", rng.uniform(0.0, 2.0 * np.pi, 3)))

        def within(ee: Array) -> np.ndarray:
            return (ee[:, 2] >= low) & (ee[:, 2] <= high)

        either = self.start == "any"
        accept = within if self.restrict_start or either else None
        joints = random_arm(solver, rng, accept, either=either)
        zero = np.array(0.0)
        return Start(planar_pose(zero, zero, np.array(heading)), joints, target[np.newaxis])

    def _heights(self, solver: IkSolver) -> tuple[float, float]:
        if self.heights is not None:
            return self.heights
        reach = solver.robot.reach
        return reach.comfortable if self.restrict_start else (reach.low, reach.high)


def ggr(**parameters: object) -> GoalReaching:
    """Goal reaching at all heights of the robot's reach."""
    return named(GoalReaching, "ggr", {}, parameters)


def ggr_restricted(**parameters: object) -> GoalReaching:
    """Goal reaching with start and goal at comfortable heights."""
    return named(GoalReaching, "ggr_restricted", {"restrict_start": True}, parameters)


def spline(**parameters: object) -> GoalReaching:
    """Goal reaching at comfortable heights, along smooth random curves."""
    defaults = {"motion": {"generator": "spline"}, "restrict_start": True}
    return named(GoalReaching, "spline", defaults, parameters)
