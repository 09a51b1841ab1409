"""Robots with meshes: the PyBullet world is all that loads them."""

import struct
from pathlib import Path

import pytest

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot

EXAMPLE = Path(__file__).parents[3] / "examples" / "own_robot"
CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
STL = bytes(80) + struct.pack("<I", 4) + b"".join(
    struct.pack("<12fH", 0, 0, 1, *(x for i in range(4) if i != left for x in CORNERS[i]), 0)
    for left in range(4)
)  # fmt: skip


@pytest.fixture
def rover(tmp_path):
    """The URDF of a robot in the usual layout of a package."""
    for folder in ("rover/urdf", "rover/meshes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "rover" / "meshes" / "part.stl").write_bytes(STL)
    (tmp_path / "rover" / "meshes" / "text.stl").write_text("solid a\nendsolid a\n")
    return tmp_path / "rover" / "urdf" / "rover.urdf"


def own_robot(rover, mesh, kind):
    """Return the example robot with a mesh instead of the shapes of its mast, from a package."""
    text = (EXAMPLE / "scout.urdf").read_text()
    start = text.index(f"<{kind}>", text.index('<link name="mast_link">'))
    end = text.index(f"</{kind}>", start)
    text = f'{text[:start]}<{kind}><geometry><mesh filename="{mesh}"/></geometry>{text[end:]}'
    rover.with_name("scout.urdf").write_text(text)
    rover.with_name("scout.yaml").write_text((EXAMPLE / "scout.yaml").read_text())
    return load_robot(str(rover.with_name("scout.yaml")))


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("mesh", ["../meshes/part.stl", "package://rover/meshes/part.stl"])
def test_a_robot_with_meshes_stands_in_the_world(rover, mesh, kind, capfd):
    backend = PyBulletBackend(own_robot(rover, mesh, kind))
    client, body = backend.sims[0].physics.client, backend.sims[0].body.body
    mast = backend.sims[0].body.links["mast_link"]
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
    with pytest.raises(KinfeasError, match=r"scout\.urdf.*text\.stl"):
        PyBulletBackend(robot).simulation(0)
    assert capfd.readouterr() == ("", "")
