"""The rules that every motion generator keeps, and the trial that shows whether it does."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kinfeas.core.checked_motion import CheckedMotion
from kinfeas.core.motion import State
from kinfeas.core.spatial import Array, distance, integrate
from kinfeas.testing.trial import Trial

_ARRIVED_METRES, _ARRIVED_DEGREES = 0.01, 3.0
_NEAR = 1e-9  # for the same motion in another batch, where sums may round in another order
_ROUNDING = 1e-6
_LOOKS = 10  # steps of each motion at which every rule is checked; the cheap ones are at each

RULES = {
    "form": "states, poses and twists have the right form, poses and twists finite numbers",
    "quaternions": "goal poses have quaternions of unit length",
    "copies": "what is passed in is neither written into nor kept",
    "layout": "a state keeps its keys, shapes and types",
    "repeatable": "the same question gets the same answer",
    "rows": "a motion is the same alone as in a batch",
    "restart": "single motions of a batch can start again",
    "velocity": "the speed keeps to its limit",
    "angular_velocity": "the angular speed keeps to its limit",
    "goal": "the goal stays where it is while the target does",
    "arrival": "every motion arrives in time",
}
"""What is checked, by short names."""

# Beyond these nothing more can be learned.
_FATAL = ("form", "quaternions", "copies", "layout")


@dataclass(frozen=True)
class Probe:
    """A generator whose every answer is checked for its form and its limits.

    Attributes:
        motion: Who answers.
        trial: What it is put to.
        found: Where to note a broken rule that lets the test go on; None ends it at the first.
    """

    motion: CheckedMotion
    trial: Trial
    found: dict[str, str] | None = None

    def require(self, holds: object, rule: str, broken: str) -> None:
        """Note or raise the sentence `broken`, which has the generator as its subject."""
        if holds:
            return
        error = self.motion.error(broken, rule)
        if self.found is None or rule in _FATAL:
            raise error
        self.found.setdefault(rule, str(error))

    def start(self, ee_pose: Array, target_pose: Array, rows: Sequence[int]) -> State:
        """Return the start of the motions `rows`, each with its own randomness."""
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
    """Put a generator to its trial.

    Args:
        probe: The generator, the trial and where to note what is broken.
        on_step: Called after each step.

    Raises:
        ConformanceError: If a rule is broken, and it is grave or there is nowhere to note it.
    """
    ee_pose, targets = probe.trial.poses()
    state, seen = _check_start(probe, ee_pose, targets), []
    steps = probe.trial.steps
    looks = set((np.geomspace(1, steps, _LOOKS).astype(int) - 1).tolist())
    for step in range(steps):
        if step in looks:
            seen.append(_check_step(probe, state, ee_pose, targets))
            _check_restart(probe, seen, targets)
        twist, state = probe.twist(state, ee_pose, targets)
        ee_pose = integrate(ee_pose, twist, probe.trial.dt)
        if on_step is not None:
            on_step()
    _check_arrival(probe, ee_pose, targets, (seen[0].state, state))


@dataclass(frozen=True)
class _Step:
    """What a generator was asked and what it answered, in copies of their own."""

    state: State
    ee_pose: Array
    twist: Array


def _check_start(probe: Probe, ee_pose: Array, targets: Array) -> State:
    """Return the state in which all motions start."""
    rows = range(len(ee_pose))
    given = ee_pose.copy(), targets.copy()
    state = probe.start(*given, rows)
    kept = np.array_equal(given[0], ee_pose) and np.array_equal(given[1], targets)
    probe.require(kept, "copies", "writes into the poses that start is given")
    shared = any(np.may_share_memory(v, pose) for v in state.values() for pose in given)
    probe.require(
        not shared, "copies", "keeps the poses that start is given in its state; it must copy them"
    )
    again = probe.start(ee_pose.copy(), targets.copy(), rows)
    same = _close(state, again, 0.0)
    probe.require(
        same, "repeatable", "starts differently the second time, from the same poses and rngs"
    )
    for row in _some(rows):
        one = slice(row, row + 1)
        alone = probe.start(ee_pose[one].copy(), targets[one].copy(), [row])
        same = _close(alone, _rows(state, one), _NEAR)
        probe.require(same, "rows", "starts a motion differently alone than in a batch")
    return state


def _check_step(probe: Probe, state: State, ee_pose: Array, targets: Array) -> _Step:
    """Return the step from `state`, which must be a function of what twist is given."""
    step_state, step_pose = copy.deepcopy(state), ee_pose.copy()
    given, dt = targets.copy(), np.full(len(ee_pose), probe.trial.dt)
    twist, after = copy.deepcopy(probe.twist(state, ee_pose, given, dt))
    kept = _close(state, step_state, 0.0)
    probe.require(kept, "copies", "writes into the state that twist is given")
    kept = np.array_equal(ee_pose, step_pose)
    probe.require(kept, "copies", "writes into the ee_pose that twist is given")
    kept = np.array_equal(given, targets)
    probe.require(kept, "copies", "writes into the target_pose that twist is given")
    kept = bool(np.all(dt == probe.trial.dt))
    probe.require(kept, "copies", "writes into the dt that twist is given")
    again, after_again = probe.twist(state, ee_pose, targets)
    same = np.array_equal(twist, again) and _close(after, after_again, 0.0)
    probe.require(
        same,
        "repeatable",
        "answers the same twist call differently twice; what changes belongs into the state",
    )
    uneven = dt * np.resize([1.0, 0.5], len(dt))
    mixed, after_mixed = copy.deepcopy(probe.twist(state, ee_pose, targets, uneven))
    for row in _some(range(len(ee_pose))):
        one = slice(row, row + 1)
        alone, after_alone = _alone(probe, state, ee_pose, targets, dt, one)
        same = _near(alone, twist[one]) and _close(after_alone, _rows(after, one), _NEAR)
        probe.require(same, "rows", "moves a motion differently alone than in a batch")
        alone, after_alone = _alone(probe, state, ee_pose, targets, uneven, one)
        same = _near(alone, mixed[one]) and _close(after_alone, _rows(after_mixed, one), _NEAR)
        probe.require(same, "rows", "moves a motion differently if the others have another dt")
    return _Step(step_state, step_pose, twist)


def _alone(
    probe: Probe, state: State, ee_pose: Array, targets: Array, dt: Array, one: slice
) -> tuple[Array, State]:
    """Return the step of a single motion."""
    return probe.twist(_rows(state, one), ee_pose[one].copy(), targets[one].copy(), dt[one].copy())


def _check_restart(probe: Probe, seen: list[_Step], targets: Array) -> None:
    """Check that one motion can start again while the others go on."""
    first, now = seen[0], seen[-1]
    row = len(seen) % len(targets)
    one = slice(row, row + 1)
    fresh = probe.start(first.ee_pose[one].copy(), targets[one].copy(), [row])
    state, ee_pose = copy.deepcopy(now.state), now.ee_pose.copy()
    for key, value in fresh.items():
        state[key][one] = value
    ee_pose[one] = first.ee_pose[one]
    twist, _ = probe.twist(state, ee_pose, targets)
    expected = now.twist.copy()
    expected[one] = first.twist[one]
    probe.require(
        _near(twist, expected),
        "restart",
        "moves differently once a single motion of the batch starts again; "
        "what changes belongs into the state",
    )


def _check_arrival(
    probe: Probe, ee_pose: Array, targets: Array, states: tuple[State, State]
) -> None:
    """Check that the motions end at the goal that was named at the start."""
    announced, final = (probe.motion.goal_pose(state, targets) for state in states)
    metres, radians = distance(announced, final)
    fixed = metres.max() < _NEAR and radians.max() < np.sqrt(_NEAR)
    probe.require(fixed, "goal", "moves its goal_pose during the motion")
    metres, radians = distance(ee_pose, final)
    missed = (metres > _ARRIVED_METRES) | (np.rad2deg(radians) > _ARRIVED_DEGREES)
    row = int(np.argmax(missed))
    probe.require(
        not missed.any(),
        "arrival",
        f"ends {metres[row]:.3f} m and {np.rad2deg(radians[row]):.1f} degrees from its goal_pose "
        f"after {probe.trial.duration:g} s (motion {row}); at most {_ARRIVED_METRES} m and "
        f"{_ARRIVED_DEGREES:g} degrees are allowed",
    )


def _some(rows: range) -> list[int]:
    """Return the first, the middle and the last of `rows`."""
    return sorted({rows[0], rows[len(rows) // 2], rows[-1]})


def _rows(state: State, rows: slice) -> State:
    """Return a copy of some motions."""
    return {key: value[rows].copy() for key, value in state.items()}


def _near(a: Array, b: Array) -> bool:
    """Return whether the arrays are the same up to rounding."""
    return np.allclose(a, b, rtol=_NEAR, atol=_NEAR)


def _close(a: State, b: State, tolerance: float) -> bool:
    """Return whether the states are the same up to `tolerance`; not-a-number equals itself."""
    return a.keys() == b.keys() and all(
        a[key].shape == b[key].shape
        and np.allclose(a[key], b[key], rtol=tolerance, atol=tolerance, equal_nan=True)
        for key in a
    )
