"""Geometric modulation: the base stays between two ellipses around the EE.

After Welschehold et al., "Coupling mobile base and end-effector motion in task space" (IROS 2018),
with ellipses fitted to the robot's own reach: the EE's height and the pitch of its approach axis
determine from which base positions the arm reaches it. IK finds these for targets spread evenly
over heights, pitches, rolls and positions. The base copies the EE's velocity, is led around the
ellipses where it would cross them, and turns to have the EE in front of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from kinfeas.control.observation import HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import Array, make_pose, rotation, wrap, yaw
from kinfeas.kinematics.drive import action_toward
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver, spread, spread_configurations
from kinfeas.robots.robot import Robot

_RHO_INNER, _RHO_OUTER = 1.9, 0.1  # rho in `modulated`; a larger one acts from further away
_PUSH, _FULL_PUSH = 0.1, 0.1
"""Speed of the push back into the ring, m/s, and the level's distance below 1 where it is full."""

_FREE_BEARING, _HEADING_GAIN = 0.15, 1.0
"""Bearing error without correction, radians, and the gain beyond it, rad/s per radian."""

_AHEAD = 0.6
"""Distance ahead of a differential base of the point that copies the velocity, metres."""

_TINY = 1e-6

CONE = 0.7
"""Half angle about the preferred bearing for which the ellipses are fitted, radians."""

_SCOUTS, _TARGETS = 8192, 24576  # numbers of targets, for the bearing and for the ellipses
_HEIGHT_STEP, _HEIGHT_BLUR = 0.2, 0.1  # step of the grid, and deviation of the kernel, metres
_PITCHES, _PITCH_BLUR = 9, 0.25  # number in the grid, and deviation of the kernel, radians
_CELL, _HALF_WIDTH, _BLUR = 0.1, 1.5, 0.08  # of the grid of base positions, metres
_REACHED = 0.6
"""Reach that positions between the ellipses should have, relative to the best positions."""

_CENTRES = np.arange(-_HALF_WIDTH + _CELL / 2.0, _HALF_WIDTH, _CELL)
_X, _Y = (grid.ravel() for grid in np.meshgrid(_CENTRES, _CENTRES, indexing="ij"))
_SIZES = np.arange(0.1, 0.8, 0.05)
_HOLES = np.array([(a, b) for a in _SIZES for b in _SIZES])
_IN_HOLE = (_X[:, None] / _HOLES[:, 0]) ** 2 + (_Y[:, None] / _HOLES[:, 1]) ** 2 < 1.0
_SCALES = np.arange(0.5, 1.3, 0.05)


@dataclass(frozen=True, eq=False)
class ReachEllipses:
    """Ellipses over a grid of EE heights and pitches, with x along the azimuth of the approach."""

    heights: Array  # EE heights above the floor, evenly spaced, shape (h,), metres
    # pitches of the approach axis above the horizon, evenly spaced, shape (p,), radians
    pitches: Array
    # outer centre 2, outer half axes 2 and inner half axes 2, shape (h, p, 6), metres from the EE;
    # the inner ellipse lies around the EE itself
    shapes: Array
    bearing: float  # bearing of the EE from the base at which the arm reaches most, radians

    def at(self, height: Array, pitch: Array) -> Array:
        """Return shapes, (n, 6), interpolated in the grid at heights and pitches of shape (n,)."""
        (i, u), (j, v) = _between(self.heights, height), _between(self.pitches, pitch)
        shapes = self.shapes
        low = (1.0 - v) * shapes[i, j] + v * shapes[i, j + 1]
        high = (1.0 - v) * shapes[i + 1, j] + v * shapes[i + 1, j + 1]
        return (1.0 - u) * low + u * high


def approach(robot: Robot, ee_pose: Array) -> tuple[Array, Array]:
    """Return pitch and azimuth, (n,) each, radians, of a robot's approach axis at poses (n, 7)."""
    axis = Rotation.from_quat(robot.gripper_rotation).inv().apply([1.0, 0.0, 0.0])
    axis = rotation(ee_pose).apply(axis)
    return np.arcsin(np.clip(axis[:, 2], -1.0, 1.0)), np.arctan2(axis[:, 1], axis[:, 0])


def fit_ellipses(robot: Robot) -> ReachEllipses:
    """Return the ellipses of a robot, without randomness, in about two seconds.

    First, targets in all directions give the bearing at which the arm reaches most. Then the
    ellipses of each height and pitch in the grid are fitted to targets near these and that bearing.
    The outer ellipse has the centre and the proportions of the base positions with enough reach.
    The sizes of both are such that the ring has the most of these positions and the fewest others.
    """
    low, high = robot.reach.low, robot.reach.high
    solver = IkSolver(robot, IkOptions(candidates=1, restarts=8))
    scouts = _Targets(solver, _SCOUTS, 0.0, np.pi)
    bearing = _best_bearing(scouts)
    targets = _Targets(solver, _TARGETS, bearing, CONE)
    heights = np.linspace(low, high, max(2, round((high - low) / _HEIGHT_STEP) + 1))
    pitches = np.linspace(-np.pi / 2.0, np.pi / 2.0, _PITCHES)
    shapes = np.array([[_fit(targets, height, pitch) for pitch in pitches] for height in heights])
    if np.isnan(shapes).all():
        raise KinfeasError(
            f"geometric_modulation finds no position from which the arm of robot {robot.name!r} "
            f"has its reach, {low:g} to {high:g} m"
        )
    return ReachEllipses(heights, pitches, _filled(shapes), bearing)


class _Targets:
    """EE poses spread over heights, pitches and rolls, and whether the arm reaches them.

    Attributes:
        height: Height of the EE above the floor, shape (n,), metres.
        pitch: Pitch of the approach axis above the horizon, shape (n,), radians.
        bearing: Bearing of the EE from the base, shape (n,), radians.
        position: Position of the base from the EE, x along the azimuth, shape (n, 2), metres.
        reached: Whether IK succeeded, shape (n,).
    """

    def __init__(self, solver: IkSolver, count: int, bearing: float, cone: float) -> None:
        robot = solver.robot
        samples = spread(count, 6)
        low, high = robot.reach.low, robot.reach.high
        ee = forward(solver.chain, spread_configurations(robot, 4096))
        reach = float(np.hypot(ee[:, 0], ee[:, 1]).max())
        self.height = low - 0.2 + samples[:, 0] * (high - low + 0.4)
        self.pitch = np.pi * (samples[:, 1] - 0.5)
        self.bearing = bearing + cone * (2.0 * samples[:, 2] - 1.0)
        distance = reach * samples[:, 3]
        azimuth, roll = 2.0 * np.pi * samples[:, 4], 2.0 * np.pi * samples[:, 5]
        x, y = distance * np.cos(self.bearing), distance * np.sin(self.bearing)
        angles = np.stack([azimuth, -self.pitch, roll], axis=1)
        to_gripper = Rotation.from_quat(robot.gripper_rotation)
        orientation = Rotation.from_euler("ZYX", angles) * to_gripper
        ee = make_pose(np.stack([x, y, self.height], axis=1), orientation)
        home = np.tile(robot.home["home"], (count, 1))
        self.reached = solver.solve(ee, home).feasible
        self.position = turned(np.stack([-x, -y], axis=1), -azimuth)


def turned(vectors: Array, angle: Array) -> Array:
    """Return planar vectors, shape (n, 2), rotated by `angle`, shape (n,), radians."""
    x, y = vectors[:, 0], vectors[:, 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def _best_bearing(targets: _Targets) -> float:
    middles = np.linspace(-np.pi, np.pi, 73)[1:]
    near = np.abs(wrap(targets.bearing - middles[:, None])) < CONE
    fractions = [targets.reached[rows].mean() for rows in near]
    best = np.array(fractions) >= 0.98 * max(fractions)
    return float(np.angle(np.exp(1j * middles[best]).sum()))


def _fit(targets: _Targets, height: float, pitch: float) -> Array:
    """Return the ellipses at a height and a pitch, (6,); NaN if the arm reaches too little."""
    off_height = (targets.height - height) / _HEIGHT_BLUR
    off_pitch = (targets.pitch - pitch) / _PITCH_BLUR
    kernel = np.exp(-0.5 * (off_height * off_height + off_pitch * off_pitch))
    reach = _reach(targets, kernel)
    good = reach > _REACHED
    if np.count_nonzero(good) < 4:
        return np.full(6, np.nan)
    centre = np.array([_X[good].mean(), _Y[good].mean()])
    axes = 2.0 * np.array([_X[good].std(), _Y[good].std()]) + _CELL / 2.0
    level = np.hypot((_X - centre[0]) / axes[0], (_Y - centre[1]) / axes[1])
    gain, hole = reach - _REACHED, np.full(2, _SIZES[0])
    for _ in range(3):
        ring = np.where((_X / hole[0]) ** 2 + (_Y / hole[1]) ** 2 < 1.0, 0.0, gain)
        scale = _SCALES[np.argmax([ring[level < scale].sum() for scale in _SCALES])]
        inside = np.where(level < scale, gain, 0.0)
        hole = _HOLES[np.argmin(np.where(_IN_HOLE, inside[:, None], 0.0).sum(axis=0))]
    return np.concatenate([centre, axes * scale, hole])


def _reach(targets: _Targets, kernel: Array) -> Array:
    """Return the fraction of targets reached from each position, relative to the best, (c,)."""
    x, y = targets.position[:, 0], targets.position[:, 1]
    edges = np.append(_CENTRES - _CELL / 2.0, _HALF_WIDTH)

    def counted(weights: Array) -> Array:
        counts, *_ = np.histogram2d(x, y, bins=(edges, edges), weights=weights)
        return gaussian_filter(counts, _BLUR / _CELL).ravel()

    tried, reached = counted(kernel), counted(kernel * targets.reached)
    reach = np.where(tried > 1e-4 * tried.max(), reached / np.maximum(tried, 1e-12), 0.0)
    positive = reach[reach > 0.01]
    return reach / np.quantile(positive, 0.98) if len(positive) else reach


def _filled(shapes: Array) -> Array:
    missing = np.isnan(shapes[..., 0])
    fitted = np.argwhere(~missing)
    filled = shapes.copy()
    for cell in np.argwhere(missing):
        nearest = fitted[np.argmin(np.sum((fitted - cell) ** 2, axis=1))]
        filled[tuple(cell)] = shapes[tuple(nearest)]
    return filled


def _between(grid: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the index of the grid point below each value, and the fraction of the step above."""
    position = np.clip((value - grid[0]) / (grid[1] - grid[0]), 0.0, len(grid) - 1.0)
    index = np.minimum(position.astype(np.intp), len(grid) - 2)
    return index, (position - index)[:, None]


@dataclass(frozen=True, eq=False)
class GeometricModulation:
    """Moves the base with the EE, within reach of it.

    The velocity is measured from the achieved EE position to the planned one, so that the base
    also reduces the tracking error. An omnidirectional base copies the modulated velocity and turns
    to the bearing. A differential base gives that velocity to a point ahead of it, and adds the
    rotation to the bearing.
    """

    robot: Robot
    ellipses: ReachEllipses

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        base, ee = self.robot.base, observation.ee_pose
        offset = observation.base_pose[:, :2] - ee[:, :2]
        velocity = (observation.planned[:, :2] - ee[:, :2]) / HORIZON
        velocity = velocity + self._correction(ee, observation.planned, offset)
        heading = yaw(observation.base_pose)
        error = wrap(np.arctan2(-offset[:, 1], -offset[:, 0]) - heading - self.ellipses.bearing)
        turn = _HEADING_GAIN * np.sign(error) * np.maximum(np.abs(error) - _FREE_BEARING, 0.0)
        if base.drive == "omnidirectional":
            action = action_toward(base, observation.base_pose, velocity, HORIZON)
            action[:, 2] = turn / base.max_rotation
        else:
            in_base = turned(velocity, -heading)
            turn = turn + in_base[:, 1] / _AHEAD
            action = np.stack([in_base[:, 0] / base.max_velocity, turn / base.max_rotation], axis=1)
        return np.clip(action, -1.0, 1.0)

    def _correction(self, ee: Array, planned: Array, offset: Array) -> Array:
        """Return the correction of the EE's velocity by the ellipses, world axes, (n, 2), m/s.

        The ellipses turn with the azimuth of the approach axis: relative to them, a base that only
        copies the EE's velocity drifts.
        """
        pitch, azimuth = approach(self.robot, ee)
        _, later = approach(self.robot, planned)
        # Where the axis is nearly vertical, its azimuth is noise, and the ellipses are round.
        spin = np.where(np.cos(pitch) > 0.1, wrap(later - azimuth), 0.0)
        position = turned(offset, -azimuth)
        drift = (turned(offset, -azimuth - spin) - position) / HORIZON
        shape = self.ellipses.at(ee[:, 2], pitch)
        return turned(modulated(position, drift, shape) - drift, azimuth)


def geometric_modulation(robot: Robot) -> GeometricModulation:
    """Return the baseline that keeps the base between two reach ellipses; takes about 2 s."""
    return GeometricModulation(robot, fit_ellipses(robot))


def modulated(position: Array, velocity: Array, shape: Array) -> Array:
    """Return a velocity that does not leave the ring between two ellipses, and leads back into it.

    Welschehold et al. (2018): along the normal of a boundary that is approached, the velocity is
    scaled by `1 - w / level^(1/rho)`, along its tangent by `1 + w / level^(1/rho)`.

    Args:
        position: Position in the frame of the ellipses, shape (n, 2), metres.
        velocity: Velocity relative to the ellipses, shape (n, 2), m/s.
        shape: As `ReachEllipses.shapes`, shape (n, 6).
    """
    level_in, normal_in = _boundary(position, shape[:, 4:6])
    level_out, normal_out = _boundary(position - shape[:, :2], shape[:, 2:4])
    level_out, normal_out = 1.0 / level_out, -normal_out
    above_in, above_out = np.maximum(level_in - 1.0, _TINY), np.maximum(level_out - 1.0, _TINY)
    weight_in = above_out / (above_in + above_out)
    velocity = _led_around(velocity, normal_in, weight_in * _decay(level_in, _RHO_INNER))
    velocity = _led_around(velocity, normal_out, (1.0 - weight_in) * _decay(level_out, _RHO_OUTER))
    return velocity + _push(level_in) * normal_in + _push(level_out) * normal_out


def _boundary(position: Array, axes: Array) -> tuple[Array, Array]:
    """Return the level of an ellipse, 1 on it and more outside, (n, 1), and its normal, (n, 2)."""
    scaled = position / axes
    level = scaled[:, :1] ** 2 + scaled[:, 1:] ** 2
    normal = scaled / axes
    length = np.sqrt(normal[:, :1] ** 2 + normal[:, 1:] ** 2)
    return np.maximum(level, _TINY), normal / np.maximum(length, _TINY)


def _decay(level: Array, rho: float) -> Array:
    return np.maximum(level, 1.0) ** (-1.0 / rho)


def _led_around(velocity: Array, normal: Array, strength: Array) -> Array:
    along_normal = velocity[:, :1] * normal[:, :1] + velocity[:, 1:] * normal[:, 1:]
    toward = along_normal * normal
    strength = np.where(along_normal < 0.0, strength, 0.0)
    return (1.0 - strength) * toward + (1.0 + strength) * (velocity - toward)


def _push(level: Array) -> Array:
    return _PUSH * np.clip((1.0 - level) / _FULL_PUSH, 0.0, 1.0)
