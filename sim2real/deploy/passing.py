"""What wrappers around a backend share that change neither episodes nor grips."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import (
    Backend,
    BackendWrapper,
    Grip,
    Stochastic,
    SupportsGripper,
    SupportsObstacleDistances,
)


class Passing(BackendWrapper):
    """Passes on to a backend what it can beside its steps."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        if isinstance(backend, SupportsObstacleDistances):
            self.obstacle_distances = backend.obstacle_distances

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Pass on to a backend that draws random numbers."""
        if isinstance(self.backend, Stochastic):
            self.backend.seed(seeds, env_ids)

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Pass on to a backend that has grippers."""
        if isinstance(self.backend, SupportsGripper):
            self.backend.grip(grip, env_ids)
