"""Demonstrations of a door, models learned from them, and runs of generators."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import compose, integrate, make_pose, planar_pose
from kinfeas.io.demonstrations import Demonstration, write_demonstration
from kinfeas.plugins.fit import fit, write_model
from kinfeas.plugins.path import below
from tests.builders import random_poses

KINDS = ("imitation", "gaussian_mixture")
DT = 0.1
RADIUS, ANGLE = 0.312, np.deg2rad(96.0)

WAYPOINTS = np.array([
    [-0.3, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0],
    [-0.15, 0.1, 0.25, 0.0, np.sin(0.3), 0.0, np.cos(0.3)],
    [-0.1, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0],
    [0.0, 0.05, 0.0, 0.0, 0.0, np.sin(0.5), np.cos(0.5)],
])  # fmt: skip


def door_demonstrations(n=6, seed=0, scatter=1.0, base=True):
    """Return demonstrations of an EE that opens a door, which turns about the object's z axis.

    `scatter` scales the differences of the grasps; the motion itself is the same.
    """
    rng = np.random.default_rng(seed)
    return [_door_demonstration(rng, scatter, base) for _ in range(n)]


def _door_demonstration(rng, scatter, base):
    time = np.linspace(0.0, rng.uniform(2.0, 5.0), 120)
    share = time / time[-1]
    done = 10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5
    angle = done * ANGLE
    arc = RADIUS * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle], axis=-1)
    turn = Rotation.from_rotvec(angle[:, np.newaxis] * np.array([0.0, 0.0, 0.85]))
    held = Rotation.from_rotvec(scatter * rng.normal(0.0, 0.08, 3))
    ee = make_pose(arc + scatter * rng.normal(0.0, 0.008, 3), turn * held)
    spot = rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0), rng.uniform(-3.0, 3.0)
    door = planar_pose(*np.array(spot)[:, np.newaxis])
    door[:, 2] = 0.7
    door = np.repeat(door, len(time), axis=0)
    walked = planar_pose(-0.7 - 0.3 * done, 0.3 * done, np.pi + 0.5 * done)
    stood = compose(below(door), walked) if base else np.full_like(ee, np.nan)
    return Demonstration(time, compose(door, ee), stood, door)


SHOWN = door_demonstrations(1)[0]


def starts_and_targets(n, seed):
    """Return starts up to 3 m away from the targets, and the targets, in any orientation."""
    targets, away = random_poses(n, seed), random_poses(n, seed + 1, reach=1.7)
    away[:, :3] += targets[:, :3]
    return away, targets


def run(generator, start, target, duration, dt=DT, *, state=None, on_step=lambda *now: now[1]):
    """Return poses, shape (steps + 1, n, 7), twists, (steps, n, 6), and the last state."""
    poses, twists = [start], []
    if state is None:
        state = generator.start(start, target, [None] * len(start))
    for i in range(round(duration / dt)):
        twist, state = generator.twist(state, poses[-1], target, np.full(len(start), dt))
        poses.append(integrate(poses[-1], twist, dt))
        twists.append(twist)
        state = on_step(i, state, poses[-1])
    return np.stack(poses), np.stack(twists), state


def speeds(twists):
    return np.linalg.norm(twists[..., :3], axis=-1), np.linalg.norm(twists[..., 3:], axis=-1)


def write_waypoints(path, poses=WAYPOINTS, time=None):
    rows = [",".join(map(repr, row)) for row in np.asarray(poses).tolist()]
    header = "x,y,z,qx,qy,qz,qw"
    if time is not None:
        header, rows = f"{header},time", [f"{row},{t}" for row, t in zip(rows, time, strict=True)]
    path.write_text("\n".join([header, *rows]))
    return str(path)


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """Paths by the generators that read them; `nobase` is an imitation model without the base."""
    folder, shown = tmp_path_factory.mktemp("files"), door_demonstrations()
    for kind in KINDS:
        write_model(fit(shown, kind).model, folder / f"{kind}.yaml")
    write_model(fit(door_demonstrations(base=False)).model, folder / "nobase.yaml")
    write_demonstration(SHOWN, folder / "replay.csv")
    write_waypoints(folder / "waypoints.csv")
    return {path.stem: str(path) for path in folder.iterdir()}
