import numpy as np
import pytest

from kinfeas.core.checks.arrays import are_unit, instead, sound
from kinfeas.core.spatial import IDENTITY

ZERO = np.zeros((3, 6))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (ZERO, ""),
        (ZERO.astype(np.float32), ""),
        (ZERO.astype(int), ""),
        (ZERO * np.nan, ""),
        (ZERO[:, :5], "(3, 5)"),
        (ZERO[0], "(6,)"),
        (ZERO.tolist(), "list"),
        (None, "NoneType"),
        (ZERO.astype(object), "an array of object"),
        (ZERO.astype(bool), "an array of bool"),
        (ZERO.astype(complex), "an array of complex128"),
    ],
)
def test_instead(value, words):
    assert instead(value, (3, 6)) == words


class Tensor:
    """What has a shape and is no array."""

    shape = (3, 6)


def test_what_only_looks_like_an_array_is_called_by_its_class():
    assert instead(Tensor(), (3, 6)) == "Tensor"


@pytest.mark.parametrize("value", [ZERO, np.full((3, 6), 1e-300), np.empty((0, 6))])
def test_finite_floats_are_surely_sound(value):
    assert sound(value, value.shape)


@pytest.mark.parametrize(
    "value",
    [
        ZERO.tolist(),
        ZERO[:2],
        ZERO.astype(np.float32),
        ZERO.astype(object),
        ZERO * np.nan,
        ZERO + np.array([np.inf, -np.inf, 0.0, 0.0, 0.0, 0.0]),
        np.full((3, 6), 1e200),
    ],
)
def test_whatever_else_is_not_surely_so(value):
    assert not sound(value, (3, 6))


@pytest.mark.parametrize("shape", [(7,), (3, 7), (2, 3, 7), (0, 7)])
def test_unit_quaternions(shape):
    poses = np.broadcast_to(IDENTITY, shape)
    assert are_unit(poses)
    assert are_unit(-poses)
    assert not poses.size or not (are_unit(poses * 1.00001) or are_unit(poses * np.nan))
