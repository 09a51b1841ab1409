import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core import registry
from kinfeas.core.spatial import compose, distance, make_pose, planar_pose, relative
from kinfeas.plugins.fit import fit
from kinfeas.plugins.imitation import learned_path, read_model
from kinfeas.scenes.scene import read_scene
from tests.builders import assert_near
from tests.plugins.conftest import run

N = 16
SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "simulated_demonstrations.py"))


def rollout(model, ee_pose, target):
    """Return the poses (t, n, 7) of a motion, which arrives."""
    generator = registry.build("kinfeas.motion_generators", "imitation", {"model": model})
    poses, _, state = run(generator, ee_pose, target, 100.0)
    metres, radians = distance(poses[-1], generator.goal_pose(state, target))
    assert max(metres.max(), radians.max()) < 1e-3
    return poses


@pytest.fixture(scope="module", params=["door", "drawer"])
def rolled(request):
    """Name, and grasp and opening in the handle's frame, from random starts in front of it."""
    rng, name = np.random.default_rng(7), request.param
    x, y, yaw = rng.uniform(-2.0, 2.0, (3, N))
    target = compose(planar_pose(x, y, yaw), read_scene("room").handle_pose(name))
    away = rng.uniform([-1.0, -0.8, -0.5], [-0.3, 0.8, 0.5], (N, 3))
    start = compose(target, make_pose(away, Rotation.random(N, rng)))
    grasp = rollout(f"{name}_grasp", start, target)
    pull = rollout(f"{name}_open", grasp[-1], target)
    return name, relative(grasp, target), relative(pull, target)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_documented_commands_make_them(name):
    pairs = SCRIPT["demonstrate"](name, 12, seed=0)
    for motion, shown in zip(("grasp", "open"), zip(*pairs, strict=True), strict=True):
        made = fit(shown, "imitation", 8, 0).model
        shipped = read_model(f"{name}_{motion}", "imitation")
        assert made.duration == pytest.approx(shipped.duration)
        index = np.linspace(0.0, 1.0, 50)
        assert_near(learned_path(made).at(index), learned_path(shipped).at(index), 1e-3, 1e-2)


def test_every_grasp_ends_at_the_handle(rolled):
    name, grasp, _ = rolled
    held = make_pose(np.zeros(3), Rotation.from_rotvec([SCRIPT["ROLL"][name], 0.0, 0.0]))
    metres, radians = distance(grasp[-1], held)
    assert metres.max() < 0.01
    assert np.rad2deg(radians).max() < 6.0
    # From the side, too, the hand first comes in front of the handle.
    near = np.linalg.norm(grasp[..., :3], axis=-1) < 0.04
    for row in range(N):
        assert np.abs(grasp[near[:, row], row, 1]).max() < 0.02
