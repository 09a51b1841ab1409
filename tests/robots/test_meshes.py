from xml.etree import ElementTree

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.robots.elements import Element, find_mesh

FORMATS = (".stl", ".obj", ".dae")


@pytest.fixture
def rover(tmp_path):
    """The URDF of a robot in the usual layout of a package, with another package beside it."""
    for folder in ("rover/urdf", "rover/meshes", "rover_meshes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "rover" / "meshes" / "part.stl").touch()
    (tmp_path / "rover_meshes" / "PART.STL").touch()
    return tmp_path / "rover" / "urdf" / "rover.urdf"


def found(name, urdf):
    mesh = Element(ElementTree.Element("mesh", filename=name), f"{urdf}: link 'base', <mesh>")
    return find_mesh(mesh, urdf.absolute().parent, FORMATS)


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("../meshes/part.stl", "rover/meshes/part.stl"),
        ("{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("file://{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("package://rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("package:///rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("package://rover_meshes/PART.STL", "rover_meshes/PART.STL"),
    ],
)
def test_meshes_are_found_from_any_folder(rover, tmp_path, monkeypatch, name, where):
    monkeypatch.chdir(tmp_path)
    for urdf in (rover, rover.relative_to(tmp_path)):
        path = found(name.format(tmp_path), urdf)
        assert path.is_absolute()
        assert path.samefile(tmp_path / where)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../meshes/none.stl", "there is no '../meshes/none.stl', from the folder '.*urdf'"),
        ("package://lander/part.stl", "there is no 'package://lander/part.stl'"),
        ("../meshes", r"'../meshes' must be of the format \.stl, \.obj, \.dae"),
        ("part.ply", "must be of the format"),
        ("http://a/part.stl", "must be a path, or begin with file:// or package://"),
        ("a" * 300 + ".stl", "cannot be read: File name too long"),
    ],
)
def test_meshes_that_are_not_there_are_one_sentence(rover, name, message):
    with pytest.raises(KinfeasError, match=f"rover.urdf: link 'base', <mesh>: .*{message}"):
        found(name, rover)
