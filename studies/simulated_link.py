"""The pattern of `kinfeas identify --drive` against a simulated robot, in simulated time.

Both ends are those of `kinfeas identify --drive` and `kinfeas simulate`, and a link with a delay of
its own replaces the bus. Unlike real-time runs it does not depend on the load of the machine.
"""

import heapq
import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinfeas.api.deploy import recorded
from kinfeas.api.load import load_robot, read_adapters
from kinfeas.config.recipes import load_section
from kinfeas.core.backend import Grip
from kinfeas.core.start import episode_rng
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.sim2real.deploy.config import DeployConfig
from kinfeas.sim2real.deploy.runtime import Setup
from kinfeas.sim2real.deploy.start import warm_up
from kinfeas.sim2real.identify.excitation import SECONDS, Excitation
from kinfeas.sim2real.link import JointPath, Readings
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.rate import Clock
from kinfeas.sim2real.simulator import SimulatedRobot, spawn

DELAY, WORK, MORE_WORK = 0.001, 0.002, 0.0005
"""Seconds of a message, and of computing a command: at least, and on average beyond that."""


class SimulatedLink:
    """A link to a simulated robot, and the clock of both; sleeping lets simulated time pass."""

    robot: SimulatedRobot
    base_source = joint_source = "the simulated robot"

    def __init__(self, step: float, phase: float) -> None:
        """Start with the first step of `step` seconds after `phase` seconds."""
        self.now, self.step = 1000.0, step
        self.clock = Clock(lambda: self.now, lambda: self.now, self.passes)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers, self._rng = itertools.count(), np.random.default_rng(int(1e6 * phase))
        self._readings: Readings | None = None
        self._at(self.now + phase, self._tick)

    def passes(self, seconds: float) -> None:
        """Let time pass, with all that happens until then."""
        end = self.now + max(seconds, 0.0)
        while self._events and self._events[0][0] <= end:
            self.now, _, happens = heapq.heappop(self._events)
            happens()
        self.now = end

    def open(self, readings: Readings) -> None:
        """Pass measurements on from now."""
        self._readings = readings

    def waits_for(self) -> None:
        """Return that no command lacks a receiver."""

    def check(self) -> None:
        """Do nothing: the link does not break."""

    def drive(self, velocity: np.ndarray) -> None:
        """Send a velocity, after the time that its computing takes."""
        self.passes(WORK + self._rng.exponential(MORE_WORK))
        sent = velocity.copy()
        self._at(self.now + DELAY, lambda: self.robot.orders().drive(sent))

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send a trajectory."""
        path = JointPath(
            tuple(positions), np.array([seconds]), np.array([list(positions.values())])
        )
        self._at(self.now + DELAY, lambda: self.robot.orders().move(path))

    def grip(self, grip: Grip) -> None:
        """Do nothing: the pattern has no grip."""

    def close(self) -> None:
        """Do nothing."""

    def _at(self, when: float, happens: Callable[[], None]) -> None:
        heapq.heappush(self._events, (when, next(self._numbers), happens))

    def _tick(self) -> None:
        base, joints = self.robot.measure()

        def arrive() -> None:
            if self._readings is not None:
                self._readings.base(base)
                self._readings.joints(joints)

        self._at(self.now + DELAY, arrive)
        self.robot.step(self.step)
        self._at(self.now + self.step, self._tick)


def drive(name: str, adapters: str, seed: int, record: Path, dt: float, step: float) -> None:
    """Record the pattern with control periods of `dt` and simulation steps of `step` seconds."""
    robot = load_robot(name)
    world, state = spawn(robot, rng=episode_rng(seed, 0), adapters=read_adapters(adapters))
    link = SimulatedLink(step, phase=(0.618034 * seed % 1.0) * step)
    link.robot = SimulatedRobot(world, state, clock=link.clock)
    link.passes(1.0)  # robots are on before a deployment starts
    config = load_section(DeployConfig, "deploy", robot.folder)
    solver, policy = IkSolver(robot, config.ik), load_policy("stationary", robot)
    excitation = Excitation(solver, dt)
    warm_up(solver, policy, excitation, dt, filters=[excitation])
    setup = Setup(
        solver=solver, policy=policy, task=excitation, dt=dt, seconds=SECONDS,
        backend=LinkBackend(robot, link, clock=link.clock), leading=(excitation,),
        config=replace(config, filters=(), arm_settle_timeout=0.0), clock=link.clock,
    )  # fmt: skip
    outcome = recorded(setup, name, "stationary", "simulated_link", record).outcome
    world.close()
    assert outcome.code == 0, outcome.reason
