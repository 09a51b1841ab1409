import re
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kinfeas.backends.physics.robot import (
    FRAME,
    Inertia,
    merge_fixed_links,
    physical,
    read_inertia,
    repair_inertias,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.elements import read_xml
from tests.backends.conftest import STL, place, stay

MOMENTS = st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)
BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
ARM = (
    f'<robot name="r"><link name="arm">{BOX}<inertial><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial></link><link name="tool">{tool}</link>'
    '<joint name="j" type="{type}"><parent link="arm"/><child link="tool"/></joint></robot>'
)


def test_merged_links_have_the_same_dynamics_and_shapes(robot, tmp_path):
    xml = read_xml(robot.urdf_path, "robot").xml
    part_of = merge_fixed_links(xml, keep={robot.ee_frame})
    left = {link.get("name") for link in xml.findall("link")}
    assert set(part_of) == set(robot.urdf.links)
    assert set(part_of.values()) == left
    assert len(left) < len(part_of)
    merged = tmp_path / "merged.urdf"
    merged.write_text(ElementTree.tostring(xml, encoding="unicode"))
    rng = np.random.default_rng(0)
    models = [pinocchio.buildModelFromUrdf(str(path)) for path in (robot.urdf_path, merged)]
    for _ in range(20):
        configuration = pinocchio.integrate(
            models[0], pinocchio.neutral(models[0]), rng.uniform(-3.0, 3.0, models[0].nv)
        )
        speed, force = rng.normal(size=(2, models[0].nv))
        before, after = (
            pinocchio.aba(model, model.createData(), configuration, speed, force)
            for model in models
        )
        np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)
    before = shape_placements(models[0], robot.urdf_path, configuration)
    after = shape_placements(models[1], merged, configuration)
    np.testing.assert_allclose(after, before, atol=1e-9)


def shape_placements(model, path, configuration):
    """Return the placements of the collision shapes, sorted."""
    shapes = pinocchio.buildGeomFromUrdf(model, str(path), pinocchio.GeometryType.COLLISION)
    data, geometry = model.createData(), shapes.createData()
    pinocchio.updateGeometryPlacements(model, data, shapes, geometry, configuration)
    placements = np.array([pose.homogeneous[:3].ravel() for pose in geometry.oMg])
    return placements[np.lexsort(placements.T.round(6))]


@given(MOMENTS, st.integers(0, 1000), st.floats(1e-3, 100.0))
def test_repaired_moments_satisfy_the_triangle_inequality(moments, seed, mass):
    axes = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    repaired = physical(Inertia(mass, np.zeros(3), axes @ np.diag(moments) @ axes.T))
    small, middle, large = np.linalg.eigvalsh(repaired.moments)
    assert small > 0.0
    assert small + middle >= large * (1.0 - 1e-9)
    assert physical(repaired) is repaired


@pytest.mark.parametrize(("tool", "joint"), [("", "fixed"), (BOX, "fixed"), ("", "revolute")])
def test_only_a_moving_link_with_a_shape_needs_an_inertia(tool, joint):
    xml = ElementTree.fromstring(ARM.format(tool=tool, type=joint))
    repair_inertias(xml, "r.urdf")
    arm, frame = (read_inertia(link) for link in xml.findall("link"))
    assert (arm.mass, frame.mass) == (2.0, FRAME.mass)
    np.testing.assert_array_equal(frame.moments, FRAME.moments)
    moving = ElementTree.fromstring(ARM.format(tool=BOX, type="revolute"))
    with pytest.raises(KinfeasError, match=r"r\.urdf: link 'tool'"):
        repair_inertias(moving, "r.urdf")


@pytest.mark.parametrize(
    ("kind", "mesh"),
    [("visual", "../meshes/part.stl"), ("collision", "package://rover/meshes/part.stl")],
)
def test_meshes_are_loaded(scout, kind, mesh, tmp_path, capfd, opened):
    def of_the_mast(urdf):
        start = urdf.index(f"<{kind}>", urdf.index('<link name="mast_link">'))
        shape = f'<{kind}><geometry><mesh filename="{mesh}"/></geometry>'
        return urdf[:start] + shape + urdf[urdf.index(f"</{kind}>", start) :]

    (tmp_path / "rover" / "meshes").mkdir(parents=True)
    (tmp_path / "rover" / "meshes" / "part.stl").write_bytes(STL)
    world = opened(scout(of_the_mast))
    place(world)
    stay(world, 5)
    assert capfd.readouterr().out == ""


def test_a_robot_without_collision_shapes_stands_among_obstacles(opened, scene, scout):
    bare = scout(lambda urdf: re.sub("<collision>.*?</collision>", "", urdf, flags=re.S))
    world = opened(bare, scene)
    place(world, scene=scene)
    stay(world, 3)
    assert world.obstacle_distances(1.0).distance.size == 0
