import math
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Demonstrated
from kinfeas.core.spatial import IDENTITY, compose, distance, make_pose, planar_pose, relative
from kinfeas.io.demonstrations import Demonstration
from kinfeas.plugins.fit import fit
from kinfeas.plugins.imitation import GaussianMixture, Imitation, learned_path, read_model, regress
from kinfeas.plugins.path import below
from tests.builders import assert_near, random_poses
from tests.plugins.conftest import (
    ANGLE,
    KINDS,
    RADIUS,
    door_demonstrations,
    run,
    starts_and_targets,
)

BASE = [-0.7, 0.0, np.pi], [-1.0, 0.3, np.pi + 0.5]  # x, y and yaw in the first and last pose


@pytest.fixture(params=KINDS)
def model(request, files):
    return read_model(files[request.param], request.param)


@pytest.fixture(scope="module")
def imitation(files):
    return Imitation(model=files["imitation"])


@pytest.fixture(scope="module")
def mixture(files):
    return GaussianMixture(model=files["gaussian_mixture"])


def test_regression_is_the_mean_of_the_conditional_density(model):
    index = np.array([0.0, 0.31, 0.77, 1.0])
    for row, at in zip(regress(model, index), index, strict=True):
        likely, expected = [], []
        for component in model.components:
            mean, covariance = np.array(component.mean), np.array(component.covariance)
            likely.append(component.weight * multivariate_normal(mean[0], covariance[0]).pdf(at))
            expected.append(mean[1:] + covariance[1:] / covariance[0] * (at - mean[0]))
        assert np.allclose(row, np.average(expected, axis=0, weights=likely), atol=1e-12)


def test_paths_are_smooth_even_between_knots_and_end_at_the_goal(model):
    path = learned_path(model)
    assert_near(path.knots[-1], np.array(model.goal), 1e-7, 1e-7)
    fine = path.at(np.linspace(0.0, 1.0, 4 * (len(path.knots) - 1) + 1))
    assert np.abs(fine[::4] - path.knots).max() < 1e-12
    metres = distance(fine[:-1], fine[1:])[0].reshape(-1, 4)
    assert np.allclose(metres, metres[:, :1], atol=1e-12)
    # Drawn to the goal without a bend: a segment is 2 to 4 mm long.
    assert np.abs(np.diff(path.segments[:, :3], axis=0)).max() < 3e-4


def test_generators_return_the_base_or_nan(files, imitation, mixture):
    start, target = starts_and_targets(3, 3)
    for generator in (imitation, mixture):
        assert isinstance(generator, Demonstrated)
        states = generator.start(start, target, []), run(generator, start, target, 100.0)[2]
        for state, base in zip(states, BASE, strict=True):
            expected = compose(below(target), planar_pose(*np.array(base)))
            assert_near(generator.base_pose(state, target), expected, 0.02, 0.03)
    bare = Imitation(model=files["nobase"])
    assert np.isnan(bare.base_pose(bare.start(start, target, []), target)).all()


def test_imitation_first_comes_to_the_beginning_then_follows_the_path(imitation):
    path = imitation.path
    start, target = starts_and_targets(20, 9)
    poses, _, state = run(imitation, start, target, 100.0)
    metres, radians = distance(poses, compose(target, path.knots[0]))
    # The phase begins to move within a fraction of its scales, 5 cm and 0.3 rad.
    assert np.all((metres < 0.08).any(axis=0))
    assert np.all((radians < 0.4).any(axis=0))
    assert np.array_equal(state["phase"], np.ones(20))
    poses, _, _ = run(imitation, path.knots[:1], np.eye(1, 7, 6), 30.0)
    metres = np.linalg.norm(poses[:, 0, np.newaxis, :3] - path.knots[:, :3], axis=-1)
    assert metres.min(axis=1).max() < 4e-3
    assert metres.min(axis=0).max() < 1e-2


def test_gaussian_mixture_keeps_its_time_or_runs_ahead(mixture):
    target = random_poses(3, 0)
    start = compose(target, mixture.path.knots[0])
    poses, _, state = run(mixture, start, target, 30.0)
    for share in (0.25, 0.5, 1.0):
        now = relative(poses[round(300 * share)], target)
        assert_near(now, mixture.path.at(np.full(3, share)), 1e-3, 0.02)
    assert np.allclose(state["phase"], 1.0)
    assert mixture.finished(state, target).all()
    _, _, before = run(mixture, start, target, 29.5)
    assert not mixture.finished(before, target).any()
    far = target + np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    poses, _, state = run(mixture, far, target, 10.0)
    reference = compose(target, mixture.path.at(state["phase"]))
    assert distance(reference, poses[-1])[0].min() > 0.5


def test_models_are_found_by_name_and_path_and_have_a_kind(files):
    assert read_model("door_open", "imitation").has_base
    assert not read_model(files["nobase"], "imitation").has_base
    for missing, named in (("door_opn", "'door_open'"), ("here.yaml", r"here\.yaml")):
        with pytest.raises(KinfeasError, match=named):
            read_model(missing, "imitation")
    with pytest.raises(KinfeasError, match="'kind'"):
        GaussianMixture(model=files["imitation"])


def test_models_of_format_1_have_whole_covariances(files, tmp_path):
    data, old = strict_yaml.read(Path(files["imitation"])), tmp_path / "old.yaml"
    strict_yaml.write(data | {"format": 1}, old)
    with pytest.raises(KinfeasError, match=f"^{old}: .*components"):
        read_model(str(old), "imitation")
    for component in data["components"]:
        component["covariance"] = [[number, 9.0] for number in component["covariance"]]
    strict_yaml.write(data | {"format": 1}, old)
    assert read_model(str(old), "imitation") == read_model(files["imitation"], "imitation")


@pytest.mark.parametrize(("key", "value"), [
    ("format", 3), ("kind", "spline"), ("goal.6", 2.0), ("components", []),
    ("components.0.covariance.0", 0.0), ("components.0.weight", 0.9),
    ("components.1.mean.2", math.inf), ("components.1.mean", [0.0] * 8),
])  # fmt: skip
def test_wrong_models_raise(key, value, files, tmp_path):
    entry = broken = strict_yaml.read(Path(files["imitation"]))
    *above, last = (int(part) if part.isdigit() else part for part in key.split("."))
    for part in above:
        entry = entry[part]
    entry[last] = value
    path = tmp_path / "broken.yaml"
    strict_yaml.write(broken, path)
    with pytest.raises(KinfeasError, match=f"^{path}: .*{key.split('.')[0]}"):
        read_model(str(path), "imitation")


def knots(shown, **options):
    return learned_path(fit(shown, **options).model).knots


@pytest.mark.parametrize("kind", KINDS)
def test_learns_the_demonstrated_path_and_the_mean_end(kind):
    result = fit(door_demonstrations(scatter=0.0), kind)
    path = learned_path(result.model).knots
    radius = np.hypot(path[:, 0] + RADIUS, path[:, 1])
    assert np.abs(radius - RADIUS).max() < 0.008
    assert np.abs(path[:, 2]).max() < 1e-6
    assert max(result.position_residual) < 0.004
    assert max(result.rotation_residual) < 0.02
    assert result.length == pytest.approx(RADIUS * ANGLE, rel=0.02)
    shown = door_demonstrations()
    ends = np.stack([relative(one.ee_pose[-1], one.object_pose[0]) for one in shown])
    mean = make_pose(ends[:, :3].mean(axis=0), Rotation.from_quat(ends[:, 3:]).mean())
    assert max(distance(knots(shown, kind=kind)[-1], mean)) < 1e-7


def reaches(seed, count=6, noise=0.01, start=0.0, side=0.0):
    """Return noisy reaches of 0.8 m; starts scatter by `start` and odd ones bow to -y by `side`."""
    rng, share = np.random.default_rng(seed), np.linspace(0.0, 1.0, 120)[:, np.newaxis]
    eased, shown = 10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5, []
    for number in range(count):
        begin = np.array([-0.8, 0.0, 0.0]) + rng.uniform(-start, start, 3)
        way = begin * (1.0 - eased) + noise * rng.normal(size=(120, 3))
        way[:, 1:2] += side * (-1.0) ** number * np.sin(np.pi * share)
        ee = make_pose(way, Rotation.from_rotvec(noise * rng.normal(size=(120, 3))))
        still = np.tile(IDENTITY, (120, 1))
        shown.append(Demonstration(4.0 * share[:, 0], ee, still * np.nan, still))
    return shown


@pytest.mark.parametrize("kind", KINDS)
def test_two_sides_of_an_obstacle_are_two_paths_and_scattered_starts_and_noise_are_one(kind):
    for options in ({}, {"start": 0.05}, {"count": 4, "side": 0.15}):
        sides = fit(reaches(1, **{"side": 0.25, **options}), kind, components=4).sides
        assert sides in [(0, 1) * (len(sides) // 2), (1, 0) * (len(sides) // 2)]
    for seed, start, noise in [(0, 1.0, 0.01), (1, 1.0, 0.0), (2, 0.3, 0.03), (3, 0.0, 0.02)]:
        learned = fit(reaches(seed, 7, noise, start), kind, components=4)
        assert not any(learned.sides)
    assert learned.length == pytest.approx(0.8, rel=0.05)
    assert not any(fit(door_demonstrations(seed=1), kind).sides)


def _paused(shown):
    """Return the demonstration with a second's rest before, amidst and after it."""
    last = len(shown.time) - 1
    index = np.sort(np.concatenate([np.arange(last + 1), np.repeat([0, last // 2, last], 30)]))
    poses = (shown.ee_pose, shown.base_pose, shown.object_pose)
    return Demonstration(np.arange(len(index)) / 30.0, *(pose[index] for pose in poses))


def test_the_object_s_pose_and_pauses_do_not_matter():
    shown = door_demonstrations(base=False)
    moved = [
        replace(one, ee_pose=compose(pose, one.ee_pose), object_pose=compose(pose, one.object_pose))
        for one, pose in zip(shown, random_poses(len(shown), 0), strict=True)
    ]
    expected = knots(shown)
    assert np.allclose(knots(moved), expected, atol=1e-5)
    assert np.allclose(knots([_paused(one) for one in shown]), expected, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["door", "drawer"])
def test_the_documented_commands_make_the_shipped_models(name):
    script = runpy.run_path(
        str(Path(__file__).parents[2] / "examples" / "simulated_demonstrations.py")
    )
    pairs = script["demonstrate"](name, 12, seed=0)
    for motion, shown in zip(("grasp", "open"), zip(*pairs, strict=True), strict=True):
        result = fit(shown, "imitation", 8, 0)
        assert not any(result.sides)
        shipped = read_model(f"{name}_{motion}", "imitation")
        assert result.model.duration == pytest.approx(shipped.duration)
        index = np.linspace(0.0, 1.0, 50)
        made = learned_path(result.model).at(index)
        assert_near(made, learned_path(shipped).at(index), 1e-3, 1e-2)


def test_other_wrong_input_raises():
    angle = np.linspace(0.0, 7.0, 100)[:, np.newaxis]
    ee = make_pose(np.zeros((100, 3)), Rotation.from_rotvec(angle * [0.0, 0.0, 1.0]))
    still = np.tile(IDENTITY, (100, 1))
    with pytest.raises(KinfeasError, match="3 rad"):
        fit([Demonstration(np.linspace(0.0, 5.0, 100), ee, still, still)])
    tremor = still + 1e-5 * (np.arange(100)[:, np.newaxis] % 3) * (np.arange(7) < 3)
    with pytest.raises(KinfeasError, match=r"3e-05 m and 0 rad"):
        fit([Demonstration(np.linspace(0.0, 5.0, 100), tremor, still, still)])
    ee[:, 0] = 900.0
    far = Demonstration(*(values[:3] for values in (np.arange(3.0), ee, still, still)))
    with pytest.raises(KinfeasError, match="millimetres"):
        fit([far])
    with pytest.raises(KinfeasError, match="2 samples"):
        fit([Demonstration(*(values[:2] for values in vars(far).values()))])
    with pytest.raises(KinfeasError, match="demonstration"):
        fit([])
