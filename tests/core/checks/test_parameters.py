from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.checks.parameters import check_names, in_types, signature_of
from kinfeas.core.errors import KinfeasError


@dataclass(frozen=True)
class Shape:
    width: float = 1.0


def wave(height: float, *, shape: Shape | None = None, file: Path = Path("x"), lag: "int" = 1):
    """Takes what plugins take."""


def late(shape: "Unknown" = None, **rest):  # noqa: F821  known to a type checker alone
    """Has an annotation that nobody can read."""


WAVE = signature_of(wave)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"hight": 1}, r"unknown parameter 'hight' \(did you mean 'height'\?\); known are file"),
        ({"lag": 1}, "the parameter 'height' is missing; known are file, height, lag, shape"),
    ],
)
def test_names_are_those_of_the_signature(given, sentence):
    with pytest.raises(KinfeasError, match=f"^{sentence}"):
        check_names(WAVE, given)
    check_names(WAVE, {"height": 1.0})
    check_names(signature_of(late), {"anything": 1})


def test_values_come_in_the_types_that_are_asked_for():
    given = {"shape": {"width": 2}, "file": "a.yaml"}
    assert in_types(WAVE, given, "mine") == {"shape": Shape(2.0), "file": Path("a.yaml")}
    assert given == {"shape": {"width": 2}, "file": "a.yaml"}
    with pytest.raises(KinfeasError, match=r"^mine: 'height'"):
        in_types(WAVE, {"height": "high"}, "mine")
    with pytest.raises(KinfeasError, match=r"^mine: 'lag'"):
        in_types(WAVE, {"lag": 1.5}, "mine")


def test_what_need_not_change_stays_as_it_was_written():
    for value in (3, float("inf"), object(), np.zeros(3)):
        assert in_types(WAVE, {"height": value}, "mine")["height"] is value
    assert in_types(signature_of(late), {"shape": [1]}, "mine") == {"shape": [1]}
