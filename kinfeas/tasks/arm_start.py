"""Random arm configurations to begin an episode with."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import build_collision_model, checked_links, self_collides
from kinfeas.robots.robot import Robot

_DRAWS, _ROUNDS = 16, 100
_SPREAD, _NEARLY_ALWAYS = 256, 0.9


def random_arm(
    solver: IkSolver,
    rng: np.random.Generator,
    accept: Callable[[Array], NDArray[np.bool_]] | None = None,
    *,
    either: bool = False,
) -> Array:
    """Return arm joints drawn uniformly within the limits, shape (j,).

    The robot does not touch itself there, unless `either` says so, and its tool tip is above the
    floor.

    Args:
        solver: The robot's kinematics.
        rng: Source of randomness.
        accept: Which EE poses in the base frame, shape (n, 7), may be taken; all by default.
        either: Whether it is enough that `accept` takes the pose or that the robot does not touch
            itself; both are needed by default.

    Raises:
        KinfeasError: If 1,600 draws hold no such configuration.
    """
    robot = solver.robot
    lower, upper = robot.finite_joint_limits
    tip = np.concatenate([robot.tool_tip, [0.0, 0.0, 0.0, 1.0]])
    for _ in range(_ROUNDS):
        joints = rng.uniform(lower, upper, (_DRAWS, len(lower)))
        ee = forward(solver.chain, joints)
        good = spatial.compose(ee, np.broadcast_to(tip, ee.shape))[:, 2] > 0.0
        wanted = np.ones(_DRAWS, dtype=np.bool_) if accept is None else accept(ee)
        for row in np.flatnonzero(good if either else good & wanted):
            if (either and wanted[row]) or not self_collides(solver.collision, joints[row]):
                return joints[row]
    raise KinfeasError(
        f"robot {robot.name!r}: no arm configuration free of self-collision with the EE where the "
        f"task wants it was found in {_DRAWS * _ROUNDS} draws; check joint limits, ignored "
        f"collisions and goal heights{_culprits(robot)}"
    )


def _culprits(robot: Robot) -> str:
    """Return the end of a sentence that names two links which touch nearly always, if any do."""
    spread, pairs = spread_configurations(robot, _SPREAD), checked_links(robot)
    every = frozenset(map(frozenset, pairs)) | robot.ignored_collisions
    for a, b in pairs:
        model = build_collision_model(
            replace(robot, ignored_collisions=every - {frozenset((a, b))})
        )
        touching = float(np.mean(self_collides(model, spread)))
        if touching > _NEARLY_ALWAYS:
            return f"; the links {a!r} and {b!r} touch in {touching:.0%} of all configurations"
    return ""
