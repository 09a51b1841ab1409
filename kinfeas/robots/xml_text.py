"""Numbers and poses as the text of a URDF has them."""

import warnings
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

from kinfeas.core.spatial import Array, rotation


def numbers_text(numbers: Iterable[float], digits: int | None = None) -> str:
    """Return numbers side by side, with so many digits after the point, or with all they have."""
    plain = [float(number) for number in numbers]
    if digits is None:
        return " ".join(map(repr, plain))
    return " ".join(f"{round(number, digits) + 0.0:g}" for number in plain)  # 0 and not -0


def set_origin(element: Any, pose: Array, digits: int | None = None) -> None:
    """Give an element an <origin>, pose of shape (7,), in place of its own; digits as above."""
    for old in element.findall("origin"):
        element.remove(old)
    with warnings.catch_warnings():
        # Of many angles for one rotation, in gimbal lock, any will do.
        warnings.simplefilter("ignore", UserWarning)
        rpy = rotation(pose).as_euler("xyz")
    place, turn = numbers_text(pose[:3], digits), numbers_text(rpy, digits)
    ElementTree.SubElement(element, "origin", xyz=place, rpy=turn)
