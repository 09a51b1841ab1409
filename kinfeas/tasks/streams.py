"""Tasks whose targets move: simulated people, learned models and trackers that lead the EE."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from kinfeas.control.targets import StreamProgress, TargetInbox, TargetRules
from kinfeas.core import spatial
from kinfeas.core.errors import check_ascending
from kinfeas.core.motion import Rows
from kinfeas.core.quantities import Fraction, Positive, PositiveSeconds, Seconds
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.task import MotionSpec, Subgoal, named, random_arm

_GRID = 0.1  # seconds between the poses of a path
_MARGIN = 0.1  # distance in metres from the limits of height at which targets slow down toward them


@dataclass(frozen=True)
class Stream:
    """Follow a target that moves for a while, from a random arm configuration.

    `joystick` sends twists of an Ornstein-Uhlenbeck process, like a person who keeps the EE within
    the heights. `chunks` sends poses of a smooth path in advance, like a learned model: each chunk
    has its own position error, so that the target jumps. `carried` sends poses of an object that is
    carried along a curve at constant speed.
    """

    name: str  # task name
    kind: Literal["joystick", "chunks", "carried"]  # what sends the messages
    seconds: PositiveSeconds = 60.0  # duration of an episode
    rate: tuple[Positive, Positive] = (5.0, 30.0)  # lowest and highest rate of messages, Hz
    delay: tuple[Seconds, Seconds] = (0.0, 0.05)  # lowest and highest delay of a message, seconds
    loss: Fraction = 0.2  # largest fraction of lost messages
    speed: Positive = 0.05  # deviation of velocities by axis, m/s; for `carried` the largest speed
    angular_speed: Positive = 0.1  # the same of angular velocities, rad/s
    correlation_time: PositiveSeconds = 2.0  # time constant of the velocities, seconds
    offset: tuple[Seconds, Seconds] = (0.02, 0.1)  # range of lengths of a chunk's offset, metres
    rules: TargetRules = field(default_factory=lambda: TargetRules(timeout=0.5))  # limits
    motion: MotionSpec = field(default_factory=lambda: MotionSpec("servo"))  # generator

    def __post_init__(self) -> None:
        for name in ("rate", "delay", "offset"):
            check_ascending(name, getattr(self, name))

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """The one motion, of the EE frame."""
        return (Subgoal(self.motion),)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis."""
        (low, high), zero = self.heights(solver), np.zeros(())
        base = spatial.planar_pose(zero, zero, np.array(rng.uniform(-np.pi, np.pi)))
        joints = random_arm(solver, rng, lambda ee: (ee[:, 2] >= low) & (ee[:, 2] <= high))
        return Start(base, joints, spatial.IDENTITY[np.newaxis])

    def heights(self, solver: IkSolver) -> tuple[float, float]:
        """Return the lowest and highest target, metres; by default comfortable ones."""
        return self.rules.heights or solver.robot.reach.comfortable

    def target_stream(self, solver: IkSolver) -> "SimulatedStream":
        """Return the targets of episodes."""
        return SimulatedStream(self, self.heights(solver))


class SimulatedStream:
    """Messages of simulated senders, through the same inbox as those of real ones.

    Attributes:
        inbox: Takes the messages.
        asked: Takes the same messages, but its targets never wait for slower EEs.
    """

    def __init__(self, task: Stream, heights: tuple[float, float]) -> None:
        self.task, self._heights = task, heights
        self._chunk = 16 if task.kind == "chunks" else 2
        self.inbox, self.asked = (TargetInbox(task.rules, self._chunk) for _ in range(2))
        self._inboxes = {"inbox": self.inbox, "asked": self.asked}
        self._seeds = np.empty(0, dtype=np.uint64)
        self._read = np.empty(0, dtype=np.intp)
        self._begun = np.empty((0, 7))
        self._drawn: dict[str, Array] = {}

    def start(self, desired: Array, rngs: Sequence[np.random.Generator], rows: Rows) -> None:
        """Draw the messages of new episodes."""
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs], dtype=np.uint64)
        everyone = len(rows) == len(desired)
        begun = desired[rows]
        for inbox in self._inboxes.values():
            inbox.start(begun, None if everyone else rows)
        drawn = self._draw(seeds, begun)
        if everyone:
            self._seeds, self._read, self._begun = seeds, np.zeros(len(rows), dtype=np.intp), begun
            self._drawn = drawn
            return
        self._seeds[rows], self._read[rows], self._begun[rows] = seeds, 0, begun
        for key, values in drawn.items():
            self._drawn[key][rows] = values

    def targets(self, progress: StreamProgress) -> Array:
        """Deliver messages, move some targets to the end of the next period, and return all."""
        rows, desired, dt = progress.rows, progress.desired, progress.dt
        now = progress.periods.astype(np.float64) * dt
        received, last = self._drawn["received"], self._drawn["received"].shape[1] - 1
        while True:
            due = received[np.arange(len(now)), np.minimum(self._read, last)] <= now
            sent = np.flatnonzero(due & (self._read <= last))
            if not sent.size:
                break
            self._deliver(sent, now[sent], desired[sent])
            self._read[sent] += 1
        self.inbox.wait(rows, progress.time_scale[rows], desired[rows])
        for inbox in self._inboxes.values():
            inbox.advance(rows, now[rows], dt, progress.motion_seconds)
        return self.inbox.target

    @property
    def live(self) -> NDArray[np.bool_]:
        """Whether each target moves by a message that is not too old, shape (n,)."""
        return self.inbox.live

    @property
    def speed(self) -> Array:
        """Asked speed of the EE in the next period, shape (n,), m/s."""
        return self.asked.speed

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays by name."""
        own = {"seeds": self._seeds.copy(), "read": self._read.copy(), "begun": self._begun.copy()}
        for name, inbox in self._inboxes.items():
            own |= {f"{name}.{key}": values for key, values in inbox.snapshot().items()}
        return own

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        self._seeds, self._read = snapshot["seeds"].copy(), snapshot["read"].copy()
        self._begun = snapshot["begun"].copy()
        self._drawn = self._draw(self._seeds, self._begun)
        for name, inbox in self._inboxes.items():
            own = {k.partition(".")[2]: v for k, v in snapshot.items() if k.startswith(name)}
            inbox.restore(own)

    def _draw(self, seeds: NDArray[np.uint64], begun: Array) -> dict[str, Array]:
        """Return messages of episodes: times (m, k), and twists (m, k, 6) or path and offsets."""
        drawn = [self._draw_episode(np.random.default_rng(seed)) for seed in seeds]
        stacked = {key: np.stack([episode[key] for episode in drawn]) for key in drawn[0]}
        if self.task.kind != "joystick":
            stacked["path"] = self._path(begun, stacked.pop("twists"))
        return stacked

    def _draw_episode(self, rng: np.random.Generator) -> dict[str, Array]:
        task = self.task
        rate, loss = rng.uniform(*task.rate), rng.uniform(0.0, task.loss)
        count = int(task.seconds * task.rate[1]) + 1
        sent = (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / rate
        sent[rng.random(count) < loss] = np.inf
        received = sent + rng.uniform(*task.delay, count)
        order = np.argsort(received)
        messages = {"sent": sent[order], "received": received[order]}
        if task.kind == "joystick":
            return messages | {"twists": self._velocities(rng, count, 1.0 / rate)[order]}
        # Path and chunks reach beyond the end of the episode.
        steps = int(task.seconds / _GRID) + 10 * self._chunk
        twists = self._velocities(rng, steps, _GRID)
        direction = rng.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        offset = direction * rng.uniform(*task.offset, (count, 1))
        return messages | {"twists": twists, "offset": offset[order]}

    def _velocities(self, rng: np.random.Generator, count: int, dt: float) -> Array:
        """Return twists (count, 6) of an Ornstein-Uhlenbeck process that starts at rest."""
        task, rules = self.task, self.task.rules
        keep = np.exp(-dt / task.correlation_time)
        noise = np.sqrt(1.0 - keep**2) * rng.normal(size=(count, 6))
        twists = lfilter([1.0], [1.0, -keep], noise, axis=0)
        twists *= np.repeat([task.speed, task.angular_speed], 3)
        if task.kind == "carried":
            heading = rng.uniform(-np.pi, np.pi) + np.cumsum(twists[:, 5]) * dt
            along = rng.uniform(0.25, 1.0) * task.speed * np.minimum(1.0, np.arange(count) * dt)
            twists[:, 0], twists[:, 1] = along * np.cos(heading), along * np.sin(heading)
            twists[:, 2] *= 0.2
        speed = np.linalg.norm(twists[:, :3], axis=1, keepdims=True)
        twists[:, :3] /= np.maximum(1.0, speed / rules.max_velocity)
        return twists

    def _walled(self, twist: Array, z: Array) -> Array:
        """Return twists (m, 6) that slow down toward the limits of height."""
        low, high = self._heights
        room = np.where(twist[:, 2] > 0.0, high - z, z - low)
        twist = twist.copy()
        twist[:, 2] *= np.clip(room / _MARGIN, 0.0, 1.0)
        return twist

    def _path(self, begun: Array, twists: Array) -> Array:
        """Return the poses of paths every `_GRID` seconds, shape (m, steps, 7)."""
        poses = [begun]
        for i in range(twists.shape[1]):
            walled = self._walled(twists[:, i], poses[-1][:, 2])
            poses.append(spatial.integrate(poses[-1], walled, _GRID))
        return np.stack(poses, axis=1)

    def _deliver(self, rows: Rows, now: Array, desired: Array) -> None:
        drawn, read = self._drawn, self._read[rows]
        sent = drawn["sent"][rows, read]
        if self.task.kind == "joystick":
            twists = self._walled(drawn["twists"][rows, read], desired[:, 2])
            for inbox in self._inboxes.values():
                inbox.put_twists(rows, now, sent, twists)
            return
        path = drawn["path"]
        if self.task.kind == "carried":
            steps, times = np.rint(sent / _GRID).astype(np.intp)[:, np.newaxis], sent[:, np.newaxis]
        else:
            first = np.ceil(sent / _GRID).astype(np.intp)
            steps = first[:, np.newaxis] + np.arange(self._chunk)
            times = _GRID * steps.astype(np.float64)
        poses = path[rows[:, np.newaxis], np.clip(steps, 0, path.shape[1] - 1)]
        if self.task.kind == "chunks":
            poses[..., :3] += drawn["offset"][rows, read][:, np.newaxis]
        for inbox in self._inboxes.values():
            inbox.put_poses(rows, now, sent, times, poses)


def joystick(**parameters: object) -> Stream:
    """A person leads the EE by a joystick."""
    return named(Stream, "joystick", {"kind": "joystick"}, parameters)


def chunks(**parameters: object) -> Stream:
    """A model sends poses ahead, which jump between its messages."""
    defaults = {"kind": "chunks", "rate": (0.8, 2.5), "delay": (0.1, 0.3), "loss": 0.1}
    return named(Stream, "chunks", defaults, parameters)


def carried(**parameters: object) -> Stream:
    """The EE follows an object that is carried along a curve."""
    return named(Stream, "carried", {"kind": "carried", "speed": 0.2}, parameters)
