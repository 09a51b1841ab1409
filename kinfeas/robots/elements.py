"""XML elements whose text and numbers are checked as they are read."""

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, make_pose, rotation
from kinfeas.io.files import read_file

MAX_BYTES = 10_000_000
"""More than any URDF; it keeps a wrong path from filling the memory."""

MAX_DEPTH = 100
"""How deep elements may be nested, which ElementTree writes by recursion; a URDF needs about 5."""

LARGEST = 1e16
"""What some URDFs write for no limit; the squares and sums of such numbers are still finite."""


@dataclass(frozen=True)
class Element:
    """An XML element and the words that say in an error where it stands."""

    xml: Any
    where: str

    def error(self, message: str) -> KinfeasError:
        """Return the error that says where this element stands and what is wrong with it."""
        return KinfeasError(f"{self.where}: {message}")

    def children(self, tag: str) -> "list[Element]":
        """Return the elements `tag` right below this one."""
        inner = f"{self.where}, <{tag}>"
        return [Element(xml, inner) for xml in self.xml.findall(tag)]

    def child(self, tag: str) -> "Element | None":
        """Return the first element `tag` right below this one, or None."""
        found = self.children(tag)
        return found[0] if found else None

    def need(self, tag: str) -> "Element":
        """Return the first element `tag` right below this one, which has to be there."""
        found = self.child(tag)
        if found is None:
            raise self.error(f"<{tag}> is missing")
        return found

    def text(self, attribute: str) -> str:
        """Return an attribute that has to be there and not be blank."""
        value: str | None = self.xml.get(attribute)
        if value is None or not value.strip():
            raise self.error(f"the attribute {attribute!r} is missing or blank")
        return value

    def vector(
        self,
        attribute: str,
        size: int,
        default: tuple[float, ...] | None = None,
        most: float = LARGEST,
    ) -> tuple[float, ...]:
        """Return an attribute of `size` finite numbers.

        Args:
            attribute: Name of the attribute.
            size: How many numbers it holds.
            default: What an absent attribute means; without a default it has to be there.
            most: The largest number that is allowed, of either sign.
        """
        if default is not None and self.xml.get(attribute) is None:
            return default
        text = self.text(attribute)
        try:
            numbers = tuple(float(word) for word in text.split())
        except ValueError:
            numbers = ()
        if "_" in text or not text.isascii():  # numbers to Python, but not to C++ readers
            numbers = ()
        if len(numbers) != size or not all(map(math.isfinite, numbers)):
            allowed = "a finite number" if size == 1 else f"{size} finite numbers"
            raise self.error(f"{attribute!r} must be {allowed}, not {text[:40]!r}")
        if largest := next((number for number in numbers if abs(number) > most), None):
            raise self.error(f"{attribute!r} must be at most {most:g} in size, not {largest:g}")
        return numbers

    def number(self, attribute: str, default: float | None = None, most: float = LARGEST) -> float:
        """Return an attribute that is one finite number, of a size of at most `most`."""
        return self.vector(attribute, 1, None if default is None else (default,), most)[0]

    def not_negative(
        self, attribute: str, default: float | None = None, most: float = LARGEST
    ) -> float:
        """Return an attribute that is one finite number of at least 0 and at most `most`."""
        value = self.number(attribute, default, most)
        if value < 0.0:
            raise self.error(f"{attribute!r} must be at least 0, not {value:g}")
        return value

    def positive(self, attribute: str, size: int = 1) -> tuple[float, ...]:
        """Return an attribute of `size` finite numbers above 0, metres."""
        numbers = self.vector(attribute, size, most=FARTHEST)
        if min(numbers) <= 0.0:
            raise self.error(f"{attribute!r} must be above 0, not {min(numbers):g}")
        return numbers

    def origin(self) -> Array:
        """Return the pose that <origin> below this element gives, shape (7,)."""
        found = self.child("origin")
        if found is None:
            return make_pose(np.zeros(3), Rotation.identity())
        xyz = np.array(found.vector("xyz", 3, (0.0, 0.0, 0.0), FARTHEST))
        rpy = found.vector("rpy", 3, (0.0, 0.0, 0.0))
        return make_pose(xyz, Rotation.from_euler("xyz", rpy))


def read_xml(path: Path, tag: str) -> Element:
    """Return the root element, `tag`, of an XML file; entities and document types are refused.

    Raises:
        KinfeasError: If `path` is not a readable file of at most `MAX_BYTES`, is not XML, declares
            a document type, begins with another element, or nests them deeper than `MAX_DEPTH`.
    """
    return parse_xml(read_file(path, MAX_BYTES), tag, str(path))


def parse_xml(content: bytes | str, tag: str, source: str) -> Element:
    """Return the root element of XML that is from `source`, which errors name; as `read_xml`."""
    try:
        xml = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise KinfeasError(f"{source}: document types and entities are not allowed") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise KinfeasError(f"{source}: not XML: {error}") from error
    if xml.tag != tag:
        raise KinfeasError(f"{source}: the first element must be <{tag}>, not <{xml.tag}>")
    depth, level = 0, [xml]
    while level := [child for element in level for child in element]:
        depth += 1
    if depth > MAX_DEPTH:
        raise KinfeasError(f"{source}: elements lie in {depth} others, at most in {MAX_DEPTH}")
    return Element(xml, source)


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


_PACKAGES, _FILES = ("package", "model"), ("", "file")


def find_mesh(mesh: Element, folder: Path, formats: Sequence[str]) -> Path:
    """Return the file that an element <mesh> names.

    What names it is a path from the URDF's folder, a `file://` address, or `package://NAME/...` in
    the usual layout: the nearest folder above the URDF of that name, or beside one of these.

    Args:
        mesh: The element.
        folder: Where the URDF lies, an absolute path.
        formats: What its file may end with, such as `.stl`.

    Raises:
        KinfeasError: If the file is not there, cannot be read or has another format.
    """
    name = mesh.text("filename")
    if not name.lower().endswith(tuple(formats)):
        raise mesh.error(f"{name!r} must be of the format {', '.join(formats)}")
    try:
        for path in _candidates(mesh, name, folder):
            if path.is_file():
                path.open("rb").close()
                return path
    except OSError as error:
        raise mesh.error(f"{name!r} cannot be read: {error.strerror or error}") from error
    raise mesh.error(f"there is no {name!r}, from the folder {str(folder)!r}")


def _candidates(mesh: Element, name: str, folder: Path) -> list[Path]:
    """Return where a mesh may lie, the likeliest first."""
    scheme, _, rest = name.rpartition("://")
    if scheme in _PACKAGES:
        return [above / rest.lstrip("/") for above in (*folder.parents, folder)]
    if scheme in _FILES:
        return [folder / rest]
    raise mesh.error(f"{name!r} must be a path, or begin with file:// or package://")
