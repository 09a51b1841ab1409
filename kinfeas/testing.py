"""The conformance test that built-in and outside motion generators pass alike."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.errors import KinfeasError
from kinfeas.motion import MotionGenerator, State
from kinfeas.spatial import Array, distance, integrate, make_pose

_ARRIVED_METRES, _ARRIVED_DEGREES = 0.01, 3.0
_NEAR = 1e-9  # for the same motion in another batch, where sums may round in another order
_ROUNDING = 1e-6
_LOOKS = 10  # steps of each motion at which every rule is checked; the cheap ones are at each


class ConformanceError(KinfeasError):
    """A motion generator breaks its contract; the sentence names it and what it broke."""


def check_motion_generator(  # noqa: PLR0913  knobs of a test: by keyword, each with a default
    generator: MotionGenerator,
    *,
    target_poses: Array | None = None,
    seed: int = 0,
    duration: float = 120.0,
    dt: float = 0.1,
    max_velocity: float | None = 0.1,
    max_angular_velocity: float | None = 0.1,
) -> None:
    """Raise if `generator` breaks the contract of `MotionGenerator`; takes about a second.

    Runs a motion to each target from a random pose up to 2 m away, and four special ones: from
    the target itself, a half turn on the spot, a path without a turn, a turn with almost no path.

    Args:
        generator: What to check.
        target_poses: World poses to start toward, shape (m, 7), m >= 1; 8 random ones by default.
        seed: Seed of the random poses and of the randomness that the generator is given.
        duration: Time in seconds within which every motion has to arrive.
        dt: Duration of a step in seconds.
        max_velocity: Speed that no twist may exceed, m/s; None lifts the limit.
        max_angular_velocity: Angular speed that no twist may exceed, rad/s; None lifts the limit.

    Raises:
        ConformanceError: Names the generator and the first rule it was seen to break.
    """
    rng = np.random.default_rng(seed)
    targets = _random_poses(rng, 8) if target_poses is None else np.array(target_poses, float)
    if targets.shape[1:] != (7,) or not len(targets):
        raise KinfeasError(f"target_poses must have shape (m, 7), m >= 1, not {targets.shape}")
    ee_pose, targets = _trials(rng, targets)
    probe = _Probe(generator, seed, dt, max_velocity, max_angular_velocity)
    first = _check_start(probe, ee_pose, targets)

    steps = max(1, round(duration / dt))
    looks = set((np.geomspace(1, steps, _LOOKS).astype(int) - 1).tolist())
    state, seen = first, []
    for step in range(steps):
        if step in looks:
            seen.append(_check_step(probe, state, ee_pose))
            _check_restart(probe, seen, targets)
        twist, state = probe.twist(state, ee_pose)
        probe.require_layout(state, first)
        ee_pose = integrate(ee_pose, twist, dt)

    _check_arrival(probe, ee_pose, (seen[0].state, state), duration)


@dataclass(frozen=True)
class _Probe:
    """A generator whose every answer is checked for its form and its limits."""

    generator: MotionGenerator
    seed: int
    dt: float
    max_velocity: float | None
    max_angular_velocity: float | None

    def require(self, holds: object, broken: str) -> None:
        """Raise with the sentence `broken`, which has the generator as its subject."""
        if not holds:
            raise ConformanceError(f"motion generator {type(self.generator).__name__} {broken}")

    def start(self, ee_pose: Array, target_pose: Array, rows: Sequence[int]) -> State:
        """Return the start of the motions `rows`, each with its own randomness."""
        rngs = [np.random.default_rng([self.seed, row]) for row in rows]
        state = self.generator.start(ee_pose, target_pose, rngs)
        self._require_state("start", state, len(ee_pose))
        return state

    def goal_pose(self, state: State, n: int) -> Array:
        """Return where the n motions end."""
        goal = self.generator.goal_pose(state)
        self._require_array("goal_pose", goal, (n, 7))
        off = np.abs(np.linalg.norm(goal[:, 3:], axis=-1) - 1.0).max(initial=0.0)
        self.require(off < _ROUNDING, "returns a goal_pose whose quaternion is not of unit length")
        return goal

    def twist(self, state: State, ee_pose: Array) -> tuple[Array, State]:
        """Return the twist of the next step and the state after it."""
        answer = self.generator.twist(state, ee_pose, self.dt)
        pair = isinstance(answer, tuple) and len(answer) == 2
        self.require(pair, "must return a pair from twist: the twist and the next state")
        twist, after = answer
        self._require_array("twist", twist, (len(ee_pose), 6))
        self._require_state("twist", after, len(ee_pose))
        self._require_limit(twist[:, :3], self.max_velocity, "m/s")
        self._require_limit(twist[:, 3:], self.max_angular_velocity, "rad/s")
        return twist, after

    def require_layout(self, state: State, first: State) -> None:
        """Check that rows of `first` fit into `state`, so that single motions can start again."""
        got, expected = _layout(state), _layout(first)
        keys = sorted(k for k in got.keys() | expected.keys() if got.get(k) != expected.get(k))
        self.require(not keys, f"changes the keys, shapes or types of its state: {keys}")

    def _require_state(self, method: str, state: State, n: int) -> None:
        rule = f"must return a state from {method} that is a dict of numeric arrays"
        self.require(isinstance(state, dict), f"{rule}, not a {type(state).__name__}")
        for key, value in state.items():
            numeric = isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
            self.require(numeric, f"{rule}, and {key!r} is not")
            leading = value.ndim > 0 and len(value) == n
            self.require(
                leading, f"{rule} of leading axis {n}, and {key!r} has shape {value.shape}"
            )

    def _require_array(self, method: str, value: Array, shape: tuple[int, ...]) -> None:
        got = value.shape if isinstance(value, np.ndarray) else type(value).__name__
        rule = f"must return an array of shape {shape} from {method}"
        self.require(got == shape, f"{rule}, not {got}")
        self.require(np.isfinite(value).all(), f"returns numbers from {method} that are not finite")

    def _require_limit(self, velocity: Array, limit: float | None, unit: str) -> None:
        speed = np.linalg.norm(velocity, axis=-1).max(initial=0.0)
        kept = limit is None or speed <= limit * (1.0 + _ROUNDING)
        self.require(kept, f"moves at {speed:.4g} {unit}; at most {limit} {unit} is allowed")


@dataclass(frozen=True)
class _Step:
    """What a generator was asked and what it answered, in copies of their own."""

    state: State
    ee_pose: Array
    twist: Array


def _check_start(probe: _Probe, ee_pose: Array, targets: Array) -> State:
    """Return the state in which all motions start."""
    rows = range(len(ee_pose))
    given = ee_pose.copy(), targets.copy()
    state = probe.start(*given, rows)
    probe.require(state, "must return a state from start that holds at least the goal")
    kept = np.array_equal(given[0], ee_pose) and np.array_equal(given[1], targets)
    probe.require(kept, "writes into the poses that start is given")
    shared = any(np.may_share_memory(v, pose) for v in state.values() for pose in given)
    probe.require(not shared, "keeps the poses that start is given in its state; it must copy them")
    again = probe.start(ee_pose.copy(), targets.copy(), rows)
    same = _close(state, again, 0.0)
    probe.require(same, "starts differently the second time, from the same poses and rngs")
    for row in _some(rows):
        one = slice(row, row + 1)
        alone = probe.start(ee_pose[one].copy(), targets[one].copy(), [row])
        probe.require_layout(alone, state)
        same = _close(alone, _rows(state, one), _NEAR)
        probe.require(same, "starts a motion differently alone than in a batch")
    probe.goal_pose(state, len(ee_pose))
    return state


def _check_step(probe: _Probe, state: State, ee_pose: Array) -> _Step:
    """Return the step from `state`, which must be a function of what twist is given."""
    step_state, step_pose = copy.deepcopy(state), ee_pose.copy()
    twist, after = copy.deepcopy(probe.twist(state, ee_pose))
    kept = _close(state, step_state, 0.0)
    probe.require(kept, "writes into the state that twist is given")
    kept = np.array_equal(ee_pose, step_pose)
    probe.require(kept, "writes into the ee_pose that twist is given")
    again, after_again = probe.twist(state, ee_pose)
    same = np.array_equal(twist, again) and _close(after, after_again, 0.0)
    probe.require(
        same, "answers the same twist call differently twice; what changes belongs into the state"
    )
    for row in _some(range(len(ee_pose))):
        one = slice(row, row + 1)
        alone, after_alone = probe.twist(_rows(state, one), ee_pose[one].copy())
        same = _near(alone, twist[one]) and _close(after_alone, _rows(after, one), _NEAR)
        probe.require(same, "moves a motion differently alone than in a batch")
    return _Step(step_state, step_pose, twist)


def _check_restart(probe: _Probe, seen: list[_Step], targets: Array) -> None:
    """Check that one motion can start again while the others go on."""
    first, now = seen[0], seen[-1]
    row = len(seen) % len(targets)
    one = slice(row, row + 1)
    fresh = probe.start(first.ee_pose[one].copy(), targets[one].copy(), [row])
    state, ee_pose = copy.deepcopy(now.state), now.ee_pose.copy()
    for key, value in fresh.items():
        state[key][one] = value
    ee_pose[one] = first.ee_pose[one]
    twist, _ = probe.twist(state, ee_pose)
    expected = now.twist.copy()
    expected[one] = first.twist[one]
    probe.require(
        _near(twist, expected),
        "moves differently once a single motion of the batch starts again; "
        "what changes belongs into the state",
    )


def _check_arrival(
    probe: _Probe, ee_pose: Array, states: tuple[State, State], duration: float
) -> None:
    """Check that the motions end at the goal that was named at the start."""
    announced, final = (probe.goal_pose(state, len(ee_pose)) for state in states)
    metres, radians = distance(announced, final)
    fixed = metres.max() < _NEAR and radians.max() < np.sqrt(_NEAR)
    probe.require(fixed, "moves its goal_pose during the motion")
    metres, radians = distance(ee_pose, final)
    missed = (metres > _ARRIVED_METRES) | (np.rad2deg(radians) > _ARRIVED_DEGREES)
    row = int(np.argmax(missed))
    probe.require(
        not missed.any(),
        f"ends {metres[row]:.3f} m and {np.rad2deg(radians[row]):.1f} degrees from its goal_pose "
        f"after {duration:g} s (motion {row}); at most {_ARRIVED_METRES} m and "
        f"{_ARRIVED_DEGREES:g} degrees are allowed",
    )


def _trials(rng: np.random.Generator, targets: Array) -> tuple[Array, Array]:
    """Return starts and targets of shape (m + 4, 7): random motions, then the special ones."""
    starts = _random_poses(rng, len(targets))
    starts[:, :3] = targets[:, :3] + rng.uniform(-1.15, 1.15, (len(targets), 3))
    ends = np.resize(targets, (4, 7))
    position, orientation = ends[:, :3], Rotation.from_quat(ends[:, 3:])
    away = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.0, 0.6], [1e-7, 0.0, 0.0]])
    turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi], [0.0, 0.0, 0.0], [0.0, 2.5, 0.0]])
    special = make_pose(position + away, Rotation.from_rotvec(turn) * orientation)
    return np.concatenate([starts, special]), np.concatenate([targets, ends])


def _random_poses(rng: np.random.Generator, n: int) -> Array:
    """Return poses in a room of 4 x 4 m, turned any way, shape (n, 7)."""
    position = rng.uniform([-2.0, -2.0, 0.3], [2.0, 2.0, 1.2], (n, 3))
    return make_pose(position, Rotation.from_quat(rng.normal(size=(n, 4))))


def _some(rows: range) -> list[int]:
    """Return the first, the middle and the last of `rows`."""
    return sorted({rows[0], rows[len(rows) // 2], rows[-1]})


def _rows(state: State, rows: slice) -> State:
    """Return a copy of some motions."""
    return {key: value[rows].copy() for key, value in state.items()}


def _layout(state: State) -> dict[str, object]:
    """Return what all motions of a state have in common: shapes and types by key."""
    return {key: (value.shape[1:], value.dtype) for key, value in state.items()}


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
