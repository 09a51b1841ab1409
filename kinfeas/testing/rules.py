"""Rules of motion generators, and the trial that checks them."""

import copy
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import AHEAD
from kinfeas.core.checks import CheckedMotion
from kinfeas.core.errors import KinfeasError, plugin_frames
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.motion import State
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, distance, integrate, make_pose


@dataclass(frozen=True)
class Trial:
    """Motions and limits of a test."""

    seed: int = 0  # seed of the random poses and of the generator's random numbers
    duration: float = 120.0  # time limit of each motion in seconds
    dt: float = 0.1  # duration of a step in seconds
    max_velocity: float | None = 0.1  # maximum speed, m/s; None for no limit
    max_angular_velocity: float | None = 0.1  # maximum angular speed, rad/s; None for no limit

    @property
    def steps(self) -> int:
        """Count of steps."""
        return max(1, round(self.duration / self.dt))

    def poses(self) -> tuple[Array, Array]:
        """Return starts and targets of the motions, each of shape (12, 7).

        Eight motions to random targets from a random pose up to 2 m away, and four special ones:
        from the target itself, half a turn on the spot, a path without rotation, a rotation almost
        on the spot.
        """
        rng = np.random.default_rng(self.seed)
        targets = _random_poses(rng, 8)
        starts = _random_poses(rng, len(targets))
        starts[:, :3] = targets[:, :3] + rng.uniform(-1.15, 1.15, (len(targets), 3))
        ends = np.resize(targets, (4, 7))
        position, orientation = ends[:, :3], Rotation.from_quat(ends[:, 3:])
        away = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.0, 0.6], [1e-7, 0.0, 0.0]])
        turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi], [0.0, 0.0, 0.0], [0.0, 2.5, 0.0]])
        special = make_pose(position + away, Rotation.from_rotvec(turn) * orientation)
        return np.concatenate([starts, special]), np.concatenate([targets, ends])


@dataclass(frozen=True, eq=False)
class Samples:
    """t steps of n motions: world poses (t + 1, n, 7), twists (t, n, 6) and goals (n, 7)."""

    ee_pose: Array
    twist: Array
    goal: Array


def sample_motions(motion: CheckedMotion, trial: Trial) -> Samples:
    """Return the motions of a trial."""
    ee_pose, targets = trial.poses()
    rngs = [np.random.default_rng([trial.seed, row]) for row in range(len(targets))]
    state = motion.start(ee_pose.copy(), targets.copy(), rngs)
    goal, poses, twists = motion.goal_pose(state, targets), [ee_pose], []
    for _ in range(trial.steps):
        twist, state = motion.twist(state, ee_pose, targets, np.full(len(targets), trial.dt))
        ee_pose = integrate(ee_pose, twist, trial.dt)
        poses.append(ee_pose)
        twists.append(twist)
    return Samples(np.stack(poses), np.stack(twists), goal)


def describe(error: BaseException, motion: CheckedMotion) -> str:
    """Return the message of an error, with subject and line if a generator's code raised it.

    The line is the last one in the generator's own file, if the traceback has any.
    """
    if isinstance(error, KinfeasError):
        return str(error)
    message = f"{motion.subject} raises {type(error).__name__}: {error}"
    if not (count := plugin_frames(error)):
        return message
    frames = traceback.extract_tb(error.__traceback__)[-count:]
    file = getattr(sys.modules.get(type(motion.generator).__module__), "__file__", None)
    frame = ([each for each in frames if each.filename == file] or frames)[-1]
    return f"{message} ({Path(frame.filename).name}, line {frame.lineno})"


def _random_poses(rng: np.random.Generator, n: int) -> Array:
    """Return poses in a room of 4 x 4 m with any orientation, shape (n, 7)."""
    position = rng.uniform([-2.0, -2.0, 0.3], [2.0, 2.0, 1.2], (n, 3))
    return make_pose(position, Rotation.from_quat(rng.normal(size=(n, 4))))


_ARRIVED_METRES, _ARRIVED_DEGREES = 0.01, 3.0
_NEAR = 1e-9  # for the same motion in another batch, where sums may round in another order
_ROUNDING = 1e-6
_MOVED = np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # displacement of targets, metres
_BOX = [3.0, 0.0, 0.0, 0.1, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]  # a row of `Solids.from_table`
_BATCH = "a motion differently alone and in a batch; if it computes in float32, float64 helps"
_FULL_CHECKS = 10  # steps at which all rules are checked; cheap ones are checked at each step

RULES = {
    "form": "states, poses and twists have the right shapes; poses and twists are finite",
    "quaternions": "goal poses have unit quaternions",
    "copies": "arguments are neither modified nor kept",
    "layout": "the keys, shapes and types of a state are constant",
    "repeatable": "equal calls return equal values",
    "rows": "a motion does not depend on the batch",
    "restart": "single motions of a batch can restart",
    "velocity": "the speed is within its limit",
    "angular_velocity": "the angular speed is within its limit",
    "goal": "the goal is constant while the target is",
    "end": "motions that have ended stay at their goal",
    "arrival": "every motion reaches its goal in time, and ends",
}
"""Descriptions of the rules."""

# Violations that end the test.
_FATAL = ("form", "quaternions", "copies", "layout")


@dataclass(frozen=True)
class Probe:
    """A generator with its trial, and the violations by rule."""

    motion: CheckedMotion
    trial: Trial
    violations: dict[str, str] = field(default_factory=dict)

    def require(self, holds: object, rule: str, broken: str) -> None:
        """Record a violation, or raise a severe one, unless `holds`."""
        if holds:
            return
        error = self.motion.error(broken, rule)
        if rule in _FATAL:
            raise error
        self.violations.setdefault(rule, str(error))

    def start(self, ee_pose: Array, target_pose: Array, rows: Sequence[int]) -> State:
        """Return the start state of the motions `rows`, each with its own random numbers."""
        rngs = [np.random.default_rng([self.trial.seed, row]) for row in rows]
        return self.motion.start(ee_pose, target_pose, rngs)

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array | None = None
    ) -> tuple[Array, State]:
        """Return the twist of the next step and the state after it; the trial's dt by default."""
        dt = np.full(len(ee_pose), self.trial.dt) if dt is None else dt
        twist, after = self.motion.twist(state, ee_pose, target_pose, dt)
        self._require_limit("velocity", twist[:, :3], self.trial.max_velocity, "m/s")
        self._require_limit(
            "angular_velocity", twist[:, 3:], self.trial.max_angular_velocity, "rad/s"
        )
        return twist, after

    def _require_limit(self, rule: str, velocity: Array, limit: float | None, unit: str) -> None:
        speed = np.linalg.norm(velocity, axis=-1).max(initial=0.0)
        kept = limit is None or speed <= limit * (1.0 + _ROUNDING)
        self.require(kept, rule, f"moves at {speed:.4g} {unit}; at most {limit} {unit} is allowed")


def run_trial(probe: Probe, on_step: Callable[[], None] | None = None) -> None:
    """Run the trial of a generator; `on_step` is called after each step.

    Raises:
        ConformanceError: At a severe violation.
    """
    ee_pose, targets = probe.trial.poses()
    state, history = _check_start(probe, ee_pose, targets), []
    goal, ended = probe.motion.goal_pose(state, targets), np.zeros(len(targets), dtype=np.bool_)
    steps = probe.trial.steps
    full = set((np.geomspace(1, steps, _FULL_CHECKS).astype(int) - 1).tolist())
    for step in range(steps):
        if step in full:
            history.append(_check_step(probe, state, ee_pose, targets))
            _check_goal(probe, state, targets, goal)
            _check_restart(probe, history, targets)
        ended |= probe.motion.finished(state, targets) & _within(1.0, ee_pose, goal)
        twist, state = probe.twist(state, ee_pose, targets)
        ee_pose = integrate(ee_pose, twist, probe.trial.dt)
        _check_end(probe, ended & ~_within(2.0, ee_pose, goal))
        if on_step is not None:
            on_step()
    _check_goal(probe, state, targets, goal)
    _check_arrival(probe, ee_pose, targets, state)


@dataclass(frozen=True)
class _Step:
    """Copies of the arguments and the twist of a step."""

    state: State
    ee_pose: Array
    twist: Array


def _check_start(probe: Probe, ee_pose: Array, targets: Array) -> State:
    rows = range(len(ee_pose))
    arguments = ee_pose.copy(), targets.copy()
    state = probe.start(*arguments, rows)
    kept = np.array_equal(arguments[0], ee_pose) and np.array_equal(arguments[1], targets)
    probe.require(kept, "copies", "modifies the poses passed to start")
    shared = any(np.may_share_memory(v, pose) for v in state.values() for pose in arguments)
    probe.require(not shared, "copies", "must copy the poses passed to start into its state")
    again = probe.start(ee_pose.copy(), targets.copy(), rows)
    same = _close(state, again, 0.0)
    probe.require(same, "repeatable", "returns another state from start for equal poses and rngs")
    for row in _some(rows):
        single = slice(row, row + 1)
        alone = probe.start(ee_pose[single].copy(), targets[single].copy(), [row])
        same = _close(alone, _rows(state, single), _NEAR)
        probe.require(same, "rows", f"starts {_BATCH}")
    return state


def _check_step(probe: Probe, state: State, ee_pose: Array, targets: Array) -> _Step:
    step_state, step_pose = copy.deepcopy(state), ee_pose.copy()
    target_argument, dt = targets.copy(), np.full(len(ee_pose), probe.trial.dt)
    twist, after = copy.deepcopy(probe.twist(state, ee_pose, target_argument, dt))
    for name, kept in (
        ("state", _close(state, step_state, 0.0)),
        ("ee_pose", np.array_equal(ee_pose, step_pose)),
        ("target_pose", np.array_equal(target_argument, targets)),
        ("dt", np.all(dt == probe.trial.dt)),
    ):
        probe.require(kept, "copies", f"modifies the {name} passed to twist")
    again, after_again = probe.twist(state, ee_pose, targets)
    same = np.array_equal(twist, again) and _close(after, after_again, 0.0)
    text = "returns other values from an equal call of twist; the state must hold all that changes"
    probe.require(same, "repeatable", text)
    uneven = dt * np.resize([1.0, 0.5], len(dt))
    mixed = copy.deepcopy(probe.twist(state, ee_pose, targets, uneven))
    for row in _some(range(len(ee_pose))):
        single = slice(row, row + 1)
        for durations, (batch_twist, batch_after), broken in (
            (dt, (twist, after), f"moves {_BATCH}"),
            (uneven, mixed, "moves a motion differently if other rows have another dt"),
        ):
            arrays = [values[single].copy() for values in (ee_pose, targets, durations)]
            alone, after_alone = probe.twist(_rows(state, single), *arrays)
            expected = _rows(batch_after, single)
            same = _near(alone, batch_twist[single]) and _close(after_alone, expected, _NEAR)
            probe.require(same, "rows", broken)
    # The values of these calls are checked by `CheckedMotion`.
    probe.motion.twist(state, ee_pose, targets + _MOVED, dt)
    probe.motion.base_pose(state, targets)
    probe.motion.ahead(state, ee_pose, targets, AHEAD)
    probe.motion.replan(state, ee_pose, targets, Solids.from_table([_BOX]).repeated(len(dt)))
    return _Step(step_state, step_pose, twist)


def _check_restart(probe: Probe, history: list[_Step], targets: Array) -> None:
    first, now = history[0], history[-1]
    row = len(history) % len(targets)
    single = slice(row, row + 1)
    fresh = probe.start(first.ee_pose[single].copy(), targets[single].copy(), [row])
    state, ee_pose = copy.deepcopy(now.state), now.ee_pose.copy()
    for key, value in fresh.items():
        state[key][single] = value
    ee_pose[single] = first.ee_pose[single]
    twist, _ = probe.twist(state, ee_pose, targets)
    expected = now.twist.copy()
    expected[single] = first.twist[single]
    broken = (
        "moves differently after a single motion of the batch restarts; the state must hold all "
        "that changes"
    )
    probe.require(_near(twist, expected), "restart", broken)


def _within(tolerances: float, ee_pose: Array, goal: Array) -> NDArray[np.bool_]:
    """Return whether EEs are within `tolerances` times those of success from their goals, (n,)."""
    metres, radians = distance(ee_pose, goal)
    return (metres <= tolerances * GOAL_METRES) & (radians <= tolerances * GOAL_RADIANS)


def _check_end(probe: Probe, left: NDArray[np.bool_]) -> None:
    broken = (
        f"leaves its goal_pose again after its end (motion {int(np.argmax(left))}); a motion along "
        "a path of its own needs the method finished, which must be true at the end of it only"
    )
    probe.require(not left.any(), "end", broken)


def _check_goal(probe: Probe, state: State, targets: Array, goal: Array) -> None:
    metres, radians = distance(goal, probe.motion.goal_pose(state, targets))
    fixed = metres.max() < _NEAR and radians.max() < np.sqrt(_NEAR)
    probe.require(fixed, "goal", "moves its goal_pose during the motion")


def _check_arrival(probe: Probe, ee_pose: Array, targets: Array, state: State) -> None:
    final = probe.motion.goal_pose(state, targets)
    metres, radians = distance(ee_pose, final)
    missed = (metres > _ARRIVED_METRES) | (np.rad2deg(radians) > _ARRIVED_DEGREES)
    row = int(np.argmax(missed))
    broken = (
        f"ends {metres[row]:.3f} m and {np.rad2deg(radians[row]):.1f} degrees from its goal_pose "
        f"after {probe.trial.duration:g} s (motion {row}); at most {_ARRIVED_METRES} m and "
        f"{_ARRIVED_DEGREES:g} degrees are allowed"
    )
    probe.require(not missed.any(), "arrival", broken)
    going = ~probe.motion.finished(state, targets)
    broken = f"has not finished after {probe.trial.duration:g} s (motion {int(np.argmax(going))})"
    probe.require(not going.any(), "arrival", broken)


def _some(rows: range) -> list[int]:
    return sorted({rows[0], rows[len(rows) // 2], rows[-1]})


def _rows(state: State, rows: slice) -> State:
    return {key: value[rows].copy() for key, value in state.items()}


def _near(a: Array, b: Array) -> bool:
    return np.allclose(a, b, rtol=_NEAR, atol=_NEAR)


def _close(a: State, b: State, tolerance: float) -> bool:
    """Return whether the states are the same up to `tolerance`; not-a-number equals itself."""
    return a.keys() == b.keys() and all(
        a[key].shape == b[key].shape
        and np.allclose(a[key], b[key], rtol=tolerance, atol=tolerance, equal_nan=True)
        for key in a
    )
