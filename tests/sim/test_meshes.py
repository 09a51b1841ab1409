import struct
from pathlib import Path
from xml.etree import ElementTree

import pytest

from kinfeas import registry
from kinfeas.errors import KinfeasError
from kinfeas.sim.backend import PyBulletBackend
from kinfeas.sim.meshes import place_meshes

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_robot"
CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
STL = bytes(80) + struct.pack("<I", 4) + b"".join(
    struct.pack("<12fH", 0, 0, 1, *(x for i in range(4) if i != left for x in CORNERS[i]), 0)
    for left in range(4)
)  # fmt: skip
ROBOT = (
    "<robot><link name='base'><{0}><geometry><mesh filename='{1}'/></geometry></{0}></link></robot>"
)


@pytest.fixture
def rover(tmp_path):
    """The URDF of a robot in the usual layout of a package, with another package beside it."""
    for folder in ("rover/urdf", "rover/meshes", "rover_meshes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "rover" / "meshes" / "part.stl").write_bytes(STL)
    (tmp_path / "rover" / "meshes" / "text.stl").write_text("solid a\nendsolid a\n")
    (tmp_path / "rover_meshes" / "PART.STL").write_bytes(STL)
    return tmp_path / "rover" / "urdf" / "rover.urdf"


def placed(name, urdf, kind="collision"):
    xml = ElementTree.fromstring(ROBOT.format(kind, name))
    place_meshes(xml, urdf)
    return Path(xml.find(".//mesh").get("filename"))


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("../meshes/part.stl", "rover/meshes/part.stl"),
        ("{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("file://{0}/rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("package://rover/meshes/part.stl", "rover/meshes/part.stl"),
        ("package://rover_meshes/PART.STL", "rover_meshes/PART.STL"),
    ],
)
def test_meshes_are_found_and_named_by_absolute_paths(
    rover, tmp_path, monkeypatch, kind, name, where
):
    monkeypatch.chdir(tmp_path)
    for urdf in (rover, rover.relative_to(tmp_path)):
        path = placed(name.format(tmp_path), urdf, kind)
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
        placed(name, rover)


def own_robot(rover, mesh, kind):
    """Return the example robot with a mesh instead of the shapes of its mast, from a package."""
    text = (EXAMPLE / "scout.urdf").read_text()
    start = text.index(f"<{kind}>", text.index('<link name="mast_link">'))
    end = text.index(f"</{kind}>", start)
    text = f'{text[:start]}<{kind}><geometry><mesh filename="{mesh}"/></geometry>{text[end:]}'
    rover.with_name("scout.urdf").write_text(text)
    rover.with_name("scout.yaml").write_text((EXAMPLE / "scout.yaml").read_text())
    return registry.load_robot(str(rover.with_name("scout.yaml")))


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("mesh", ["../meshes/part.stl", "package://rover/meshes/part.stl"])
def test_a_robot_with_meshes_stands_in_the_world(rover, mesh, kind, capfd):
    backend = PyBulletBackend(own_robot(rover, mesh, kind))
    client, body = backend.physics.client, backend.body.body
    mast = backend.body.links["mast_link"]
    shapes = {
        "visual": [one[4] for one in client.getVisualShapeData(body) if one[1] == mast],
        "collision": [one[4] for one in client.getCollisionShapeData(body, mast)],
    }
    backend.close()
    assert any(name.endswith(b"part.stl") for name in shapes[kind])
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("kind", ["visual", "collision"])
def test_a_mesh_that_pybullet_cannot_read_is_one_sentence(rover, kind, capfd):
    robot = own_robot(rover, "../meshes/text.stl", kind)
    with pytest.raises(
        KinfeasError, match=r"scout\.urdf: .* no triangles in the mesh '.*text\.stl'"
    ):
        PyBulletBackend(robot)
    assert capfd.readouterr() == ("", "")
