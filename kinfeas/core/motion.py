"""What a motion generator is: the seam that plugins fill in."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from kinfeas.core.spatial import Array

State = dict[str, Array]


class MotionGenerator(Protocol):
    """EE motion toward a target, for n motions at once.

    Pure: the state is passed in and handed back, a dict of arrays with leading axis n, so that a
    caller can restart single motions or look one step ahead without committing to it. States may
    share arrays, so whoever restarts single motions writes into copies. The target is an input of
    every call, since it may move; what a motion needs of its start belongs into the state. A
    generator is called once a step, is built from keyword parameters and never learns which frame
    or which robot it drives.
    """

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions that begin at `ee_pose`; it shares no memory with these.

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7).
            target_pose: Goal of the EE, or pose of the handled object, shape (n, 7).
            rngs: One source of randomness for each motion, n of them.
        """
        ...

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7).

        Args:
            state: State of n motions.
            target_pose: Where their targets are now, shape (n, 7).
        """
        ...

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: Desired world pose that the motion has come to, shape (n, 7).
            target_pose: Where the targets are now, shape (n, 7).
            dt: Duration of each motion's step in seconds, shape (n,).
        """
        ...


@runtime_checkable
class Demonstrated(Protocol):
    """What a motion generator has besides if the base was demonstrated along with the EE."""

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the base was demonstrated to be now, shape (n, 7).

        Rows of NaN where that is not known.

        Args:
            state: State of n motions.
            target_pose: Where their targets are now, shape (n, 7).
        """
        ...
