"""Elements of URDF files: checked numbers and poses, mesh files, and writing poses back."""

import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_file
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import Array, make_pose, rpy

MAX_BYTES = 10_000_000
LARGEST = 1e16
"""Limit that some URDFs write for no limit of a joint; squares and sums of it are finite."""


@dataclass(frozen=True)
class Element:
    """An XML element and the file and path that its errors begin with."""

    xml: Any
    where: str

    def error(self, message: str) -> KinfeasError:
        """Return an error that begins with the file and path of this element."""
        return KinfeasError(f"{self.where}: {message}")

    def children(self, tag: str) -> "list[Element]":
        """Return the child elements `tag`."""
        return [Element(xml, f"{self.where}, <{tag}>") for xml in self.xml.findall(tag)]

    def child(self, tag: str) -> "Element | None":
        """Return the first child element `tag`, or None."""
        xml = self.xml.find(tag)
        return None if xml is None else Element(xml, f"{self.where}, <{tag}>")

    def need(self, tag: str) -> "Element":
        """Return the first child element `tag`; an error if there is none."""
        element = self.child(tag)
        if element is None:
            raise self.error(f"<{tag}> is missing")
        return element

    def text(self, attribute: str) -> str:
        """Return an attribute; an error if it is missing or blank."""
        value: str = self.xml.get(attribute, "")
        if not value.strip():
            raise self.error(f"the attribute {attribute!r} is missing or blank")
        return value

    def vector(
        self,
        attribute: str,
        size: int,
        default: tuple[float, ...] | None = None,
        limit: float = LARGEST,
    ) -> tuple[float, ...]:
        """Return an attribute of `size` numbers up to `limit` in magnitude, or the default."""
        if default is not None and self.xml.get(attribute) is None:
            return default
        text = self.text(attribute)
        try:
            numbers = tuple(map(float, text.split()))
        except ValueError:
            numbers = ()
        if len(numbers) != size or not all(abs(number) <= limit for number in numbers):
            raise self.error(
                f"{attribute!r} must hold {size} finite numbers, at most {limit:g} in magnitude, "
                f"not {text[:40]!r}"
            )
        return numbers

    def number(
        self,
        attribute: str,
        default: float | None = None,
        limit: float = LARGEST,
        minimum: float = -math.inf,
    ) -> float:
        """Return an attribute of one number of at least `minimum`; the rest is as in `vector`."""
        (value,) = self.vector(attribute, 1, None if default is None else (default,), limit)
        if value < minimum:
            raise self.error(f"{attribute!r} must be at least {minimum:g}, not {value:g}")
        return value

    def positive(self, attribute: str, size: int = 1) -> tuple[float, ...]:
        """Return an attribute of `size` numbers above 0, metres."""
        numbers = self.vector(attribute, size, limit=FARTHEST)
        if min(numbers) <= 0.0:
            raise self.error(f"{attribute!r} must be above 0, not {min(numbers):g}")
        return numbers

    def origin(self) -> Array:
        """Return the pose of the child <origin>, shape (7,); the identity if there is none."""
        element = self.child("origin")
        if element is None:
            return make_pose(np.zeros(3), Rotation.identity())
        xyz = np.array(element.vector("xyz", 3, (0.0, 0.0, 0.0), FARTHEST))
        angles = element.vector("rpy", 3, (0.0, 0.0, 0.0))
        return make_pose(xyz, Rotation.from_euler("xyz", angles))


def read_xml(path: Path, *tags: str) -> Element:
    """Return the root element of an XML file, which has one of `tags` and no document type."""
    return parse_xml(read_file(path, MAX_BYTES), tags, str(path))


def parse_xml(content: bytes | str, tags: str | Sequence[str], source: str) -> Element:
    """Return the root element of XML; errors as in `read_xml`, with the name `source`."""
    tags = (tags,) if isinstance(tags, str) else tags
    try:
        xml = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise KinfeasError(f"{source}: document types and entities are not allowed") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise KinfeasError(f"{source}: not XML: {error}") from error
    if xml.tag not in tags:
        allowed = " or ".join(f"<{tag}>" for tag in tags)
        raise KinfeasError(f"{source}: the first element must be {allowed}, not <{xml.tag}>")
    return Element(xml, source)


def numbers_text(numbers: Iterable[float], digits: int | None = None) -> str:
    """Return numbers as the text of an attribute, with `digits` decimals or all."""
    if digits is None:
        return " ".join(repr(float(number)) for number in numbers)
    return " ".join(f"{round(float(number), digits) + 0.0:g}" for number in numbers)  # no -0


def set_origin(element: Any, pose: Array, digits: int | None = None) -> None:
    """Replace the <origin> of an XML element by `pose`, (7,); digits as in `numbers_text`."""
    for old in element.findall("origin"):
        element.remove(old)
    xyz, angles = numbers_text(pose[:3], digits), numbers_text(rpy(pose), digits)
    ElementTree.SubElement(element, "origin", xyz=xyz, rpy=angles)


_LFS = b"version https://git-lfs"
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")  # of a package.xml
_MAX_PACKAGE_BYTES = 1_000_000  # part of a package.xml in which the name is searched


def find_mesh(mesh: Element, folder: Path, formats: Sequence[str]) -> Path:
    """Return the file of a <mesh>.

    Its `filename` is a path relative to the URDF, a `file://` address or `package://NAME/...`. The
    package is the first of `packages` that contains the file. `folder` is the absolute path of the
    URDF's folder, `formats` are suffixes such as `.stl`.
    """
    name = mesh.text("filename")
    if not name.lower().endswith(tuple(formats)):
        raise mesh.error(f"{name!r} must be of the format {', '.join(formats)}")
    scheme, _, rest = name.rpartition("://")
    if scheme in ("package", "model"):
        package, _, inner = rest.lstrip("/").partition("/")
        candidates: Iterable[Path] = (location / inner for location in packages(package, folder))
        rule = (
            "; packages are looked up by package.xml above the URDF, ROS_PACKAGE_PATH, "
            "AMENT_PREFIX_PATH and folders of that name"
        )
    elif scheme in ("", "file"):
        candidates, rule = [folder / rest], ""
    else:
        raise mesh.error(f"{name!r} must be a path, or begin with file:// or package://")
    for path in candidates:
        with suppress(OSError):  # such as a name that is too long
            if path.is_file() and os.access(path, os.R_OK):
                break
    else:
        raise mesh.error(
            f"there is no {name!r}, from the folder {str(folder)!r}{rule} (`kinfeas robot import` "
            "has --mesh-path OLD=NEW and --no-meshes)"
        )
    with path.open("rb") as file:
        if file.read(len(_LFS)) == _LFS:
            raise mesh.error(f"{str(path)!r} is a pointer of Git LFS: run `git lfs pull` there")
    return path


def packages(name: str, folder: Path) -> Iterator[Path]:
    """Yield folders that may be the package `name` of a file in `folder`, an absolute path.

    These are folders at or above `folder` and below ROS_PACKAGE_PATH whose package.xml has this
    name, folders of this name in ROS_PACKAGE_PATH and in `share` of AMENT_PREFIX_PATH, and those in
    `folder` or a folder above it.
    """
    above = (folder, *folder.parents)
    for parent in above:
        if _package_name(parent / "package.xml") == name:
            yield parent
    for root in _roots("ROS_PACKAGE_PATH"):
        yield root / name
        for depth in ("", "*/", "*/*/"):
            yield from (
                p.parent for p in root.glob(f"{depth}package.xml") if _package_name(p) == name
            )
    for root in _roots("AMENT_PREFIX_PATH"):
        yield root / "share" / name
    for parent in (*folder.parents, folder):
        yield parent / name


def _roots(variable: str) -> list[Path]:
    return [Path(text) for text in os.environ.get(variable, "").split(os.pathsep) if text]


@cache
def _package_name(path: Path) -> str | None:
    with suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                match = _NAME.search(file.read(_MAX_PACKAGE_BYTES))
            return match[1].decode(errors="replace") if match else None
    return None
