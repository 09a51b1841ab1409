"""Where the trajectory controllers of a robot want its joints to be."""

from collections.abc import Mapping

import numpy as np

from kinfeas.core.spatial import Array
from kinfeas.sim2real.link import JointPath


class JointSetpoints:
    """The ways that joints were sent on, each until it is sent on another one.

    As trajectory controllers do: a new way begins where the joint is wanted at that moment, leads
    through its points in order, and its last point holds.
    """

    def __init__(self, positions: Mapping[str, float]) -> None:
        """Begin at positions, by joint, which hold until there is a way."""
        self._ways = {
            name: (np.zeros(1), np.array([position])) for name, position in positions.items()
        }

    def follow(self, path: JointPath, time: float) -> None:
        """Set out on a way; joints that are not known here are left out.

        Args:
            path: Where it leads.
            time: Now, in seconds by any clock that `at` is asked by, too.
        """
        times: Array = np.concatenate([[time], time + np.maximum(path.times, 1e-9)])
        for column, name in enumerate(path.joints):
            if name in self._ways:
                begin = np.interp(time, *self._ways[name])
                values = np.concatenate([[begin], path.positions[:, column]])
                self._ways[name] = times, values

    def at(self, time: float) -> dict[str, float]:
        """Return the positions at a time in seconds, by joint."""
        return {name: float(np.interp(time, *way)) for name, way in self._ways.items()}
