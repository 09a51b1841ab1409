import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.importer.arm import find_arm, place, read_hand
from kinfeas.importer.boxed import (
    MARGIN,
    box_masses,
    boxed_urdf,
    fit_primitives,
    on_the_floor,
)
from kinfeas.importer.description import doubts
from kinfeas.importer.draft import spec_from_urdf
from kinfeas.importer.reach import RELEVANT, only_fitted, touching
from kinfeas.robots.loading import build_robot
from kinfeas.robots.urdf_file import read_robot_xml, urdf_of

trimesh = pytest.importorskip("trimesh")

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
PALM = '<box size="0.04 0.1 0.04"/>'


def triangles(points):
    return points[ConvexHull(points).simplices]


def holds(shape, points):
    inner = np.abs(rotation(shape.pose).inv().apply(points - shape.pose[:3]))
    if shape.kind == "box":
        return np.all(inner <= np.array(shape.size) / 2.0, axis=1)
    if shape.kind == "cylinder":
        radius, length = shape.size
        return (np.hypot(inner[:, 0], inner[:, 1]) <= radius) & (inner[:, 2] <= length / 2.0)
    return np.linalg.norm(inner, axis=1) <= shape.size[0]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 60), st.floats(0.01, 2.0))
def test_primitives_enclose_their_mesh(seed, count, size):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * rng.uniform(0.1, 1.0, 3) * size + rng.normal(size=3)
    mesh = triangles(points)
    shapes = fit_primitives(mesh)
    assert 1 <= len(shapes) <= 4
    assert np.all(np.any([holds(shape, mesh.reshape(-1, 3)) for shape in shapes], axis=0))
    again = fit_primitives(mesh)
    for one, other in zip(shapes, again, strict=True):
        np.testing.assert_array_equal([*one.size, *one.pose], [*other.size, *other.pose])


def boxed(path, **options):
    return urdf_of(boxed_urdf(read_robot_xml(path), path.parent, **options))


def mesh_file(folder, suffix, corners, unit=""):
    mesh = trimesh.Trimesh(
        np.reshape(corners, (-1, 3)), np.arange(np.size(corners) // 3).reshape(-1, 3)
    )
    if suffix == "dae":
        text = trimesh.exchange.dae.export_collada(mesh).decode()
        (folder / "part.dae").write_text(text.replace("</asset>", f"{unit}</asset>"))
    else:
        (folder / f"part.{suffix}").write_bytes(mesh.export(file_type=suffix))


@pytest.mark.parametrize("suffix", ["stl", "dae"])
def test_a_mesh_becomes_primitives_in_metres(changed, tmp_path, suffix):
    size, unit = np.array([0.1, 0.2, 0.3]), '<unit name="centimeter" meter="0.01"/>'
    mesh_file(tmp_path, suffix, triangles(CUBE * size * (100.0 if suffix == "dae" else 0.5)), unit)
    scale = "1 1 1" if suffix == "dae" else "2 2 2"
    palm = boxed(changed((PALM, f'<mesh filename="part.{suffix}" scale="{scale}"/>'))).links["palm"]
    assert not palm.mesh_collisions
    np.testing.assert_allclose(sorted(palm.shapes[0].size), size + 2.0 * MARGIN, atol=1e-4)


@pytest.mark.parametrize("corners", [None, "", "v nan 0 0", "v 1e5 0 0"])
def test_broken_meshes_are_errors(changed, corners):
    path = changed((PALM, '<mesh filename="part.obj"/>'))
    if corners is not None:
        face = f"{corners}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" if corners else ""
        path.with_name("part.obj").write_text(face)
    with pytest.raises(KinfeasError, match=r"link 'palm'.*<mesh>.*part\.obj"):
        boxed(path)


SLIDE = (
    '<link name="world"/><joint name="slide" type="prismatic"><parent link="world"/>'
    '<child link="base"/><limit lower="-9" upper="9" velocity="1"/></joint>'
)
LIFT = SLIDE.replace("<limit", '<axis xyz="0 0 1"/><limit')
TURN = LIFT.replace("prismatic", "continuous")
BELOW = SLIDE.replace('"base"', '"bottom"').replace('"world"', '"map"').replace('"slide"', '"x"')
LIFT_ON_SLIDE = BELOW.replace("bottom", "world") + LIFT


@pytest.mark.parametrize(
    ("joints", "root"),
    [(SLIDE, "base"), (LIFT, "world"), (TURN, "world"), (LIFT_ON_SLIDE, "world")],
)
def test_planar_joints_below_the_base_are_left_out(changed, joints, root):
    urdf = boxed(changed(('<robot name="dolly">', f'<robot name="dolly">{joints}')))
    assert urdf.root == root
    assert "map" not in urdf.links


@pytest.mark.parametrize(("taken", "name"), [
    ({}, "base_footprint"),
    ({'name="mount"': 'name="base_footprint_joint"'}, "footprint"),
    ({"head": "base_footprint", '"tool"': '"footprint"'}, "footprint_2"),
])  # fmt: skip
def test_a_root_above_the_floor_gets_one_on_it(dolly, changed, taken, name):
    on_floor = read_robot_xml(dolly)
    assert on_the_floor(on_floor, find_arm(urdf_of(on_floor), None, "dolly")) == 0.0
    assert urdf_of(on_floor).root == "base"
    path = changed(('origin xyz="0 0 0.2"', 'origin xyz="0 0 -0.1"'), *taken.items())
    robot = read_robot_xml(path)
    lifted = on_the_floor(robot, find_arm(urdf_of(robot), None, "dolly"))
    urdf = urdf_of(robot)
    assert (urdf.root, lifted) == (name, 0.3)
    down = np.array([0.0, 0.0, -1.0])
    lowest = max(one.reach(down) for one in place(urdf, urdf.links, urdf.root, urdf.link_poses({})))
    assert lowest == pytest.approx(0.0, abs=1e-9)


MESH = '<collision><geometry><mesh filename="part.stl"/></geometry></collision>'
NARROW = 'lower="-2" upper="2"', 'lower="-0.3" upper="0.3"'

BRACKET = [  # size and centre of its plates; boxes around its halves are as large together
    ((0.4, 0.01, 0.2), (-0.1, 0.15, 0.2)),
    ((0.4, 0.01, 0.2), (-0.1, -0.15, 0.2)),
    ((0.01, 0.31, 0.2), (-0.3, 0.0, 0.2)),
]
BLOCK = [((0.4, 0.31, 0.2), (-0.1, 0.0, 0.2))]
STOP = ((0.02, 0.31, 0.02), (0.0, 0.0, 0.25))  # in the way of a small part of the postures


@pytest.mark.parametrize(
    ("parts", "false"), [(BRACKET, True), (BLOCK, False), ([*BRACKET, STOP], False)]
)
def test_pairs_are_false_contacts_if_their_meshes_never_touch(changed, parts, false):
    path = changed(NARROW, ('<link name="lower"/>', f'<link name="lower">{MESH}</link>'))
    boxes = [trimesh.creation.box(size).apply_translation(at) for size, at in parts]
    trimesh.util.concatenate(boxes).export(path.with_name("part.stl"))
    originals = {}
    urdf = boxed(path, originals=originals)
    arm = find_arm(urdf, None, "dolly")
    spec = spec_from_urdf("dolly", urdf, arm, read_hand(urdf, arm), "differential")
    robot = build_robot(spec, urdf, path, path)
    fractions, pair = touching(robot), ("lower", "palm")  # which meet in the folded arm
    assert fractions[pair] > RELEVANT
    pairs = only_fitted(robot, originals, fractions)
    assert (pair in pairs) == false
    assert pairs.items() <= fractions.items()
    assert not only_fitted(robot, {}, fractions)  # nothing was fitted


@pytest.mark.parametrize(("izz", "mass", "sizes", "doubt"), [
    (0.52, 12.0, [(0.6, 0.4, 0.2)], "base without shapes: boxes"),
    (0.62, 12.0, [], "base without shapes: their"),  # the moments of no body
    (0.52, 0.5, [], "base without shapes: their"),
])  # fmt: skip
def test_heavy_bases_without_shapes_get_the_box_of_their_inertia(
    dolly, tmp_path, izz, mass, sizes, doubt
):
    text = dolly.read_text()
    start, end = text.index("<collision>"), text.index("</collision>")
    inertia = f'<mass value="{mass}"/><inertia ixx="0.2" iyy="0.4" izz="{izz}"/>'
    inertial = f'<inertial><origin xyz="0 0 0.3"/>{inertia}</inertial>'
    dolly.write_text(text[:start] + inertial + text[end + len("</collision>") :])
    robot = read_robot_xml(dolly)
    guessed = box_masses(robot, find_arm(urdf_of(robot), None, "dolly"))
    urdf = urdf_of(robot)
    assert [shape.size for shape in urdf.links["base"].shapes] == sizes
    assert [shape.pose[2] for shape in urdf.links["base"].shapes] == [0.3] * len(sizes)
    assert any(text.startswith(doubt) for text in doubts(urdf, guessed))
