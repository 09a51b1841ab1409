"""Draw docs/images/planned.png: paths of the `planned` generator in rooms of `ggr_obstacles`."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import Array, compose
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.planned import Planned
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.obstacles import ggr_obstacles

SEEDS = (3, 5, 17, 4)
SHARES = np.linspace(0.0, 20.0, 400)


def path(solver: IkSolver, start: Start) -> Array:
    """Return the poses of the EE on its way, shape (m, 7)."""
    ee = compose(start.base_pose, forward(solver.chain, start.joint_positions))[np.newaxis]
    generator, goal, solids = Planned(), start.target_poses, start.solids
    assert solids is not None
    state = generator.start(ee, goal, [np.random.default_rng(0)])
    state = generator.replan(state, ee, goal, solids)
    return generator.ahead(state, ee, goal, SHARES)[0]


def draw(axes: Axes, start: Start, poses: Array) -> None:
    """Draw solids and a path from above."""
    solids, grey = start.solids, mpl.colormaps["Greys"]
    assert solids is not None
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    for pose, size, round_ in zip(solids.pose[0], solids.size[0], solids.cylinder[0], strict=True):
        colour = grey(0.2 + 0.35 * size[3])
        turn = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2]
        box = Polygon(pose[:2] + corners * size[:2] @ turn.T, color=colour)
        axes.add_patch(Circle(pose[:2], size[0], color=colour) if round_ else box)
    x, y, z = poses[:, :3].T
    axes.scatter(x, y, c=z, s=4, cmap="plasma", vmin=0.2, vmax=1.4)
    axes.plot(x[0], y[0], "ko", markersize=5)
    axes.plot(x[-1], y[-1], "kx", markersize=8)
    side = max(np.ptp(x), np.ptp(y)) / 2.0 + 0.8
    middle = (x.min() + x.max()) / 2.0, (y.min() + y.max()) / 2.0
    axes.set(**{f"{a}lim": (m - side, m + side) for a, m in zip("xy", middle, strict=True)})
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def main() -> None:
    """Write the picture."""
    mpl.use("Agg")
    solver, task = IkSolver(load_robot("pr2")), ggr_obstacles()
    figure = Figure(figsize=(10.0, 2.8), layout="constrained")
    for axes, seed in zip(figure.subplots(1, len(SEEDS)), SEEDS, strict=True):
        start = task.sample(solver, np.random.default_rng(seed))
        draw(axes, start, path(solver, start))
    figure.savefig(Path(__file__).parent / "images" / "planned.png", dpi=80)


if __name__ == "__main__":
    main()
