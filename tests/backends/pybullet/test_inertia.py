from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kinfeas.backends.pybullet.robot_body import (
    FRAME,
    Inertia,
    physical,
    physics_urdf,
    read_inertia,
    repair_inertias,
    write_inertia,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot

FINGER = (
    '<robot name="r"><link name="finger"><inertial><origin xyz="-0.01 0 0"/><mass value="0.08"/>'
    '<inertia ixx="0.002" ixy="0" ixz="0" iyy="0.0002" iyz="0" izz="0.0002"/></inertial>'
    '<collision><geometry><box size="0.06 0.02 0.02"/></geometry></collision></link></robot>'
)
"""A vendor's finger: one moment is larger than the other two together."""


def tensor(moments, seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    return turn @ np.diag(moments) @ turn.T


MOMENTS = st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)


@given(MOMENTS, st.integers(0, 1000), st.floats(1e-3, 100.0))
def test_what_is_made_possible_is_a_bodys(moments, seed, mass):
    mended = physical(Inertia(mass, np.zeros(3), tensor(moments, seed)))
    small, middle, large = np.linalg.eigvalsh(mended.moments)
    assert small > 0.0
    assert small + middle >= large * (1.0 - 1e-9)


@given(st.lists(st.floats(0.1, 1.0), min_size=3, max_size=3), st.integers(0, 1000))
def test_what_a_body_can_have_stays_as_it_is(squares, seed):
    # Moments of mass spread along three axes keep the triangle inequality.
    moments = np.sum(squares) - np.array(squares)
    inertia = Inertia(2.0, np.zeros(3), tensor(moments, seed))
    assert physical(inertia) is inertia


@pytest.mark.parametrize("name", ["pr2", "tiago", "hsr"])
def test_shipped_robots_are_left_alone(name):
    xml = ElementTree.fromstring(physics_urdf(load_robot(name))[0])
    before = ElementTree.tostring(xml)
    repair_inertias(xml, name)
    assert ElementTree.tostring(xml) == before


ARM = (
    '<robot name="r"><link name="arm">{arm}<inertial><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial></link>'
    '<link name="tool">{tool}</link>'
    '<joint name="j" type="{type}"><parent link="arm"/><child link="tool"/></joint></robot>'
)
BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'


@pytest.mark.parametrize(("tool", "joint"), [("", "fixed"), (BOX, "fixed"), ("", "revolute")])
def test_a_link_without_inertia_is_a_mere_frame(tool, joint):
    xml = ElementTree.fromstring(ARM.format(arm=BOX, tool=tool, type=joint))
    repair_inertias(xml, "r.urdf")
    arm, frame = (read_inertia(link) for link in xml.findall("link"))
    assert arm.mass == 2.0
    assert frame.mass == FRAME.mass
    np.testing.assert_array_equal(frame.moments, FRAME.moments)


def test_what_moves_and_has_a_shape_needs_an_inertia():
    xml = ElementTree.fromstring(ARM.format(arm="", tool=BOX, type="revolute"))
    with pytest.raises(KinfeasError, match=r"r.urdf: link 'tool' moves and has no <inertial>"):
        repair_inertias(xml, "r.urdf")


def test_what_is_written_is_read_back():
    xml = ElementTree.fromstring(FINGER).find("link")
    inertia = Inertia(0.5, np.array([0.1, 0.2, 0.3]), tensor([0.3, 0.4, 0.5], 3))
    write_inertia(xml, inertia)
    found = read_inertia(xml)
    assert found.mass == inertia.mass
    np.testing.assert_array_equal(found.centre, inertia.centre)
    np.testing.assert_allclose(found.moments, inertia.moments, atol=1e-12)


def test_pybullet_gives_a_mended_link_an_inertia(tmp_path):
    bullet = pytest.importorskip("pybullet")
    client = bullet.connect(bullet.DIRECT)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    try:
        diagonals = []
        for mend in (False, True):
            xml = ElementTree.fromstring(FINGER)
            if mend:
                repair_inertias(xml, "r.urdf")
            path = tmp_path / f"{mend}.urdf"
            path.write_text(ElementTree.tostring(xml, encoding="unicode"))
            body = bullet.loadURDF(str(path), flags=flags, physicsClientId=client)
            diagonals.append(bullet.getDynamicsInfo(body, -1, physicsClientId=client)[2])
    finally:
        bullet.disconnect(client)
    assert min(diagonals[0]) == 0.0
    assert min(diagonals[1]) > 0.0
