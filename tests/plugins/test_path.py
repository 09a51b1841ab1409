import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from kinfeas.core.spatial import compose, distance, planar_pose, yaw
from kinfeas.plugins.imitation import learned_path, read_model, regress
from kinfeas.plugins.path import below
from tests.plugins.conftest import KINDS, random_poses


@pytest.fixture(scope="module", params=KINDS)
def model(request, models):
    return read_model(models[request.param], request.param)


def test_regression_is_the_mean_of_the_conditional_density(model):
    index = np.array([0.0, 0.31, 0.77, 1.0])
    found = regress(model, index)
    for row, at in zip(found, index, strict=True):
        # By definition: E[y | x] = integral of y p(x, y) over y / p(x), for each component.
        likely, expected = [], []
        for component in model.components:
            mean, covariance = np.array(component.mean), np.array(component.covariance)
            likely.append(component.weight * multivariate_normal(mean[0], covariance[0, 0]).pdf(at))
            expected.append(mean[1:] + covariance[1:, 0] / covariance[0, 0] * (at - mean[0]))
        assert np.allclose(row, np.average(expected, axis=0, weights=likely), atol=1e-12)


def test_ends_at_the_goal_and_runs_through_its_knots(model):
    path = learned_path(model)
    metres, radians = distance(path.knots[-1], np.array(model.goal))
    assert max(metres, radians) < 1e-7
    assert np.abs(path.at(np.linspace(0.0, 1.0, len(path.knots))) - path.knots).max() < 1e-12


def test_is_even_between_knots(model):
    path = learned_path(model)
    fine = path.at(np.linspace(0.0, 1.0, 4 * (len(path.knots) - 1) + 1))
    metres, _ = distance(fine[:-1], fine[1:])
    assert np.allclose(metres.reshape(-1, 4), metres.reshape(-1, 4)[:, :1], atol=1e-12)
    assert metres.max() < 0.01


def test_is_drawn_to_the_goal_without_a_bend(model):
    path = learned_path(model)
    kinks = np.abs(np.diff(path.segments[:, :3], axis=0))
    # A segment is 2 to 4 mm long; what its neighbour differs by is the arc's own bend.
    assert kinks.max() < 3e-4


def test_base_goes_where_it_was_shown(model):
    path, index = learned_path(model), np.array([0.0, 1.0])
    door = planar_pose(np.array([1.0, 1.0]), np.array([2.0, 2.0]), np.array([0.5, 0.5]))
    door[:, 2] = 0.7
    shown = planar_pose(np.array([-0.7, -1.0]), np.array([0.0, 0.3]), np.pi + np.array([0.0, 0.5]))
    metres, radians = distance(path.base_at(index, door), compose(below(door), shown))
    assert metres.max() < 0.02
    assert radians.max() < 0.03


def test_base_is_not_known_if_not_shown(models):
    path = learned_path(read_model(models["nobase"], "imitation"))
    base = path.base_at(np.zeros(3), random_poses(3, 0))
    assert base.shape == (3, 7)
    assert np.isnan(base).all()


def test_below_keeps_position_and_heading():
    poses = random_poses(50, 1)
    floor = below(poses)
    assert np.array_equal(floor[:, :2], poses[:, :2])
    assert np.all(floor[:, 2:5] == 0.0)
    ahead = Rotation.from_quat(poses[:, 3:]).apply([1.0, 0.0, 0.0])
    assert np.allclose(yaw(floor), np.arctan2(ahead[:, 1], ahead[:, 0]))
