"""Draw docs/images/generators.png: every built-in motion generator, from the same seven starts."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from kinfeas.config import registry
from kinfeas.core.spatial import Array, integrate, make_pose

ROOT = Path(__file__).parents[1]
MOTIONS = ROOT / "examples" / "motions"
SHOWN: dict[str, object] = {"file": str(MOTIONS / "door_open.csv")}
GENERATORS: dict[str, dict[str, object]] = {
    "linear": {},
    "minimum_jerk": {},
    "waypoints": {"file": str(MOTIONS / "put_down.yaml")},
    "imitation": {"model": "door_open"},
    "replay": SHOWN,
    "spline": {"spread": 0.15},
}
SECONDS, DT = 80.0, 0.1


def starts() -> Array:
    """Return seven poses on an arc around the target, heading for it, shape (7, 7)."""
    bearing = np.linspace(0.5, 1.5, 7) * np.pi
    away = 0.9 * np.stack([np.cos(bearing), np.sin(bearing), 0.1 * np.ones(7)], axis=-1)
    return make_pose(away, Rotation.from_rotvec((bearing + np.pi)[:, np.newaxis] * [0.0, 0.0, 1.0]))


def paths(name: str, parameters: dict[str, object]) -> Array:
    """Return the poses of seven motions to a target at the origin, shape (steps + 1, 7, 7)."""
    generator = registry.build("kinfeas.motion_generators", name, parameters)
    target = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (7, 1))
    poses = [starts()]
    state = generator.start(poses[0], target, [np.random.default_rng(0)] * 7)
    for _ in range(round(SECONDS / DT)):
        twist, state = generator.twist(state, poses[-1], target, np.full(7, DT))
        poses.append(integrate(poses[-1], twist, DT))
    return np.stack(poses)


def draw(axes: Axes, name: str, poses: Array) -> None:
    """Draw the paths from above, with the x axis of the EE every four seconds."""
    axes.set_title(name, family="monospace", fontsize=11)
    for i, colour in enumerate(mpl.colormaps["viridis"](np.linspace(0.0, 0.85, 7))):
        axes.plot(poses[:, i, 0], poses[:, i, 1], color=colour, linewidth=1.4)
        some = poses[::40, i]
        ahead = 0.05 * Rotation.from_quat(some[:, 3:]).as_matrix()[:, :2, 0]
        axes.quiver(
            *some[:, :2].T, *ahead.T, color=colour, angles="xy", scale_units="xy", scale=1.0,
            width=0.004,
        )  # fmt: skip
        axes.plot(*poses[0, i, :2], "o", color=colour, markersize=4)
    axes.plot(0.0, 0.0, "k+", markersize=12, markeredgewidth=2)
    axes.set_aspect("equal")
    axes.set(xlim=(-1.0, 0.6), ylim=(-1.0, 1.0))
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    axes.tick_params(labelsize=7)


def main() -> None:
    """Write the picture."""
    mpl.use("Agg")
    figure = Figure(figsize=(10.0, 8.2), layout="constrained")
    for axes, (name, parameters) in zip(
        figure.subplots(2, 3).flat, GENERATORS.items(), strict=True
    ):
        draw(axes, name, paths(name, parameters))
    figure.savefig(ROOT / "docs" / "images" / "generators.png", dpi=80)


if __name__ == "__main__":
    main()
