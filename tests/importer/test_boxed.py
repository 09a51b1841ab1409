import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation
from kinfeas.importer.arm import find_arm, place
from kinfeas.importer.boxed import MARGIN, boxed_urdf, fit_primitives, on_the_floor
from kinfeas.robots.urdf_file import parse_urdf

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


def test_a_box_becomes_that_box_wherever_it_is():
    rng = np.random.default_rng(0)
    size, turn = np.array([0.2, 0.5, 0.9]), Rotation.random(rng=rng)
    (shape,) = fit_primitives(triangles(turn.apply(CUBE * size) + rng.normal(size=3)))
    assert shape.kind == "box"
    np.testing.assert_allclose(sorted(shape.size), size + 2.0 * MARGIN, atol=1e-6)


@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_round_meshes_become_round_primitives(kind):
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if kind == "cylinder":
        points = np.concatenate([np.insert(0.1 * circle, 2, z, axis=1) for z in (-0.3, 0.3)])
    else:
        up = np.linspace(-1.0, 1.0, 25)
        rings = [np.insert(np.sqrt(1.0 - z * z) * circle, 2, z, axis=1) for z in up]
        points = 0.1 * np.unique(np.concatenate(rings).round(9), axis=0)
    (shape,) = fit_primitives(triangles(points))
    assert shape.kind == kind
    assert shape.size[0] == pytest.approx(0.1, rel=0.02)


def boxed(path, **options):
    out = path.with_name("boxed.urdf")
    out.write_text(boxed_urdf(path, **options))
    return parse_urdf(out)


def test_primitives_and_joints_stay(dolly):
    before, after = parse_urdf(dolly), boxed(dolly)
    assert list(after.links) == list(before.links)
    for name, joint in before.joints.items():
        np.testing.assert_array_equal(after.joints[name].origin, joint.origin)
        assert after.joints[name].axis == joint.axis
    for name, link in before.links.items():
        assert [one.size for one in after.links[name].shapes] == [one.size for one in link.shapes]


def test_many_shapes_of_a_link_become_few_that_enclose_them(changed):
    rng = np.random.default_rng(0)
    centres = rng.uniform(-0.2, 0.2, (300, 3)).round(4)
    plate = '<origin xyz="{} {} {}"/><geometry><box size="0.02 0.02 0.00001"/></geometry>'
    plates = "".join(f"<collision>{plate.format(*c)}</collision>" for c in centres)
    shapes = boxed(changed(('<link name="lower"/>', f'<link name="lower">{plates}</link>')))
    shapes = shapes.links["lower"].shapes
    corners = np.concatenate([centres + corner * [0.02, 0.02, 0.0] for corner in CUBE])
    assert len(shapes) <= 4
    assert np.all(np.any([holds(shape, corners) for shape in shapes], axis=0))


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
        boxed_urdf(path)


def test_visual_shapes_replace_missing_collision_shapes(changed):
    seen = '<link name="tool"><visual><geometry><sphere radius="0.3"/></geometry></visual></link>'
    tool = ('<link name="tool"/>', seen)
    assert not boxed(changed(tool)).links["tool"].shapes
    links = boxed(changed(tool, ("collision>", "visual>"))).links
    assert links["palm"].shapes[0].size == (0.04, 0.1, 0.04)
    assert links["tool"].shapes[0].size == (0.3,)


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


def test_the_base_can_be_chosen(dolly):
    urdf = boxed(dolly, base="upper")
    assert (urdf.root, set(urdf.joints)) == ("upper", {"elbow", "mount", "frame", "l", "r"})
    with pytest.raises(KinfeasError, match="'bass'"):
        boxed_urdf(dolly, "bass")


@pytest.mark.parametrize(
    ("taken", "name"),
    [
        ({}, "base_footprint"),
        ({'name="mount"': 'name="base_footprint_joint"'}, "footprint"),
        ({"head": "base_footprint", '"tool"': '"footprint"'}, "footprint_2"),
    ],
)
def test_a_root_above_the_floor_gets_one_on_it(changed, taken, name):
    path = changed(('origin xyz="0 0 0.2"', 'origin xyz="0 0 -0.1"'), *taken.items())
    text, lifted = on_the_floor(path.read_text(), find_arm(parse_urdf(path), None, "dolly"), "")
    path.write_text(text)
    urdf = parse_urdf(path)
    assert (urdf.root, lifted) == (name, 0.3)
    down = np.array([0.0, 0.0, -1.0])
    lowest = max(one.reach(down) for one in place(urdf, urdf.links, urdf.root, urdf.link_poses({})))
    assert lowest == pytest.approx(0.0, abs=1e-9)


def test_a_root_on_the_floor_stays(dolly):
    text, arm = dolly.read_text(), find_arm(parse_urdf(dolly), None, "dolly")
    assert on_the_floor(text, arm, "") == (text, 0.0)
