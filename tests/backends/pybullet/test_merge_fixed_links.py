from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest

from kinfeas.backends.pybullet.robot_body import merge_fixed_links
from kinfeas.robots.elements import read_xml


@pytest.fixture
def models(robot, tmp_path):
    """Pinocchio's model and collision shapes of a robot, as it is and welded."""
    xml = read_xml(robot.urdf_path, "robot").xml
    merge_fixed_links(xml, keep={robot.ee_frame})
    path = tmp_path / "welded.urdf"
    path.write_text(ElementTree.tostring(xml, encoding="unicode"))
    found = []
    for urdf in (robot.urdf_path, path):
        model = pinocchio.buildModelFromUrdf(str(urdf))
        shapes = pinocchio.buildGeomFromUrdf(model, str(urdf), pinocchio.GeometryType.COLLISION)
        found.append((model, shapes))
    return found


def test_the_robot_moves_as_before(models):
    rng = np.random.default_rng(0)
    for _ in range(20):
        configuration = _configuration(models[0][0], rng)
        speed, force = rng.normal(size=(2, models[0][0].nv))
        before, after = (
            pinocchio.aba(model, model.createData(), configuration, speed, force)
            for model, _ in models
        )
        np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)


def test_no_shape_moves(models):
    configuration = _configuration(models[0][0], np.random.default_rng(0))
    before, after = (_places(model, shapes, configuration) for model, shapes in models)
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_only_joints_that_move_are_left(robot):
    xml = read_xml(robot.urdf_path, "robot").xml
    part_of = merge_fixed_links(xml, keep={robot.ee_frame})
    fixed = [joint for joint in xml.findall("joint") if joint.get("type") == "fixed"]
    assert [joint.find("child").get("link") for joint in fixed] in ([], [robot.ee_frame])
    left = {link.get("name") for link in xml.findall("link")}
    assert set(part_of) == set(robot.urdf.links)
    assert set(part_of.values()) == left
    assert all(part_of[name] == name for name in left)
    assert len(left) < len(part_of)


def test_links_without_mass_add_none():
    xml = ElementTree.fromstring(
        '<robot name="r"><link name="a"/><link name="b"/><link name="c"><inertial>'
        '<origin xyz="0 0 1"/><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
        '<joint name="ab" type="fixed"><origin xyz="1 0 0"/><parent link="a"/><child link="b"/>'
        '</joint><joint name="bc" type="fixed"><origin xyz="0 0 0" rpy="0 1.5707963267948966 0"/>'
        '<parent link="b"/><child link="c"/></joint></robot>'
    )
    assert merge_fixed_links(xml, keep=()) == {"a": "a", "b": "a", "c": "a"}
    inertial = xml.find("link").find("inertial")
    centre = [float(number) for number in inertial.find("origin").get("xyz").split()]
    np.testing.assert_allclose(centre, [2.0, 0.0, 0.0], atol=1e-12)
    assert float(inertial.find("mass").get("value")) == 2.0


def _configuration(model, rng):
    return pinocchio.integrate(model, pinocchio.neutral(model), rng.uniform(-3.0, 3.0, model.nv))


def _places(model, shapes, configuration):
    """Return where the shapes are, in an order that does not depend on their links."""
    data, geometry = model.createData(), shapes.createData()
    pinocchio.updateGeometryPlacements(model, data, shapes, geometry, configuration)
    places = np.array([one.homogeneous[:3].ravel() for one in geometry.oMg])
    return places[np.lexsort(places.T.round(6))]
