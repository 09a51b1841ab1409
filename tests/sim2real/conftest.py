"""Backends that tests of adapters wrap, and domains of ROS."""

import os

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.spatial import planar_pose
from tests.sim2real.doubles import Time
from tests.sim2real.ros_processes import own_domain


class Recorder(AnalyticBackend):
    """The analytic world, which keeps what gets through to it."""

    def __init__(self):
        super().__init__()
        self.twists, self.targets = [], []

    def step(self, base_twist, joint_targets, dt):
        self.twists.append(base_twist.copy())
        self.targets.append(joint_targets.copy())
        return super().step(base_twist, joint_targets, dt)


class Rig:
    """An adapter around a recorder, driven step by step."""

    def __init__(self, adapter, robot, n=1, first_seed=0, **parameters):
        self.recorder, self.robot = Recorder(), robot
        self.adapter = adapter(self.recorder, robot, **parameters)
        self.n, self.j = n, len(robot.arm)
        self.joints = np.zeros((n, self.j))
        self.adapter.seed(np.arange(first_seed, first_seed + n, dtype=np.uint64), np.arange(n))
        self.first = self.adapter.reset(planar_pose(*np.zeros((3, n))), self.joints)

    def run(self, twists, dt=0.1, targets=None):
        """Return the states after each of the twists, (steps, n, 6) or (steps, 6)."""
        states = []
        for i, twist in enumerate(twists):
            joints = np.broadcast_to(
                self.joints if targets is None else targets[i], (self.n, self.j)
            )
            states.append(self.adapter.step(np.broadcast_to(twist, (self.n, 6)), joints, dt))
        return states

    @property
    def passed(self):
        """Twists that got through, shape (steps, n, 6)."""
        return np.stack(self.recorder.twists)

    @property
    def sent(self):
        """Joint targets that got through, shape (steps, n, j)."""
        return np.stack(self.recorder.targets)


@pytest.fixture
def time():
    return Time()


@pytest.fixture(scope="module")
def domain():
    """A domain of ROS 2 on this computer alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", os.environ.get("CYCLONEDDS_URI", ""))  # restored at the end
        if not os.environ["CYCLONEDDS_URI"]:
            patch.delenv("CYCLONEDDS_URI")
        patch.setenv("ROS_DOMAIN_ID", own_domain())
        patch.setenv("ROS_LOCALHOST_ONLY", "1")
        yield int(own_domain())


@pytest.fixture(scope="session")
def rig(pr2):
    return lambda adapter, **arguments: Rig(adapter, pr2, **arguments)


@pytest.fixture(scope="session")
def drive():
    """Return a function that draws commands for the base, shape (steps, n, 6)."""

    def drawn(steps, n=1, seed=0):
        twists = np.zeros((steps, n, 6))
        twists[..., [0, 1, 5]] = np.random.default_rng(seed).normal(scale=0.2, size=(steps, n, 3))
        return twists

    return drawn
