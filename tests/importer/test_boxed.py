import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.importer.boxed import boxed_urdf, carried
from kinfeas.robots.urdf import parse_urdf

MESHED = '<mesh filename="part.stl" scale="0.1 0.2 0.3"/>'


def stl(triangles):
    """Return the text of an STL file."""
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    ]
    return f"solid part\n{''.join(facets)}endsolid part\n"


@pytest.fixture
def meshed(changed, cube):
    """The robot with a box of 0.1 x 0.2 x 0.3 m as a mesh in place of its palm's box."""
    path = changed(('<box size="0.04 0.1 0.04"/>', MESHED))
    path.with_name("part.stl").write_text(stl(cube))
    return path


def boxed(path, tmp_path, **options):
    out = tmp_path / "boxed.urdf"
    out.write_text(boxed_urdf(path, **options))
    return parse_urdf(out)


def test_primitives_and_joints_stay_as_they_are(dolly, tmp_path):
    before, after = parse_urdf(dolly), boxed(dolly, tmp_path)
    assert list(after.links) == list(before.links)
    for name, joint in before.joints.items():
        np.testing.assert_array_equal(after.joints[name].origin, joint.origin)
        assert after.joints[name].axis == joint.axis
    for name, link in before.links.items():
        shapes = after.links[name].shapes
        assert [shape.size for shape in shapes] == [shape.size for shape in link.shapes]


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ('<box size="0.4 0.4 0.00002"/>', (0.4, 0.4, 0.0001)),
        ('<cylinder radius="0.00004" length="1e-320"/>', (0.0001, 0.0001)),
        ('<sphere radius="0.00001"/>', (0.0001,)),
    ],
)
def test_what_is_very_thin_stays_there(changed, tmp_path, shape, size):
    path = changed(('<box size="0.04 0.1 0.04"/>', shape))
    (found,) = boxed(path, tmp_path).links["palm"].shapes
    assert found.size == size


def test_a_mesh_becomes_a_primitive_that_holds_it(meshed, tmp_path):
    pytest.importorskip("trimesh")
    palm = boxed(meshed, tmp_path).links["palm"]
    (shape,) = palm.shapes
    assert not palm.mesh_collisions
    np.testing.assert_allclose(sorted(shape.size), [0.101, 0.201, 0.301], atol=1e-4)
    assert np.all(np.array(sorted(shape.size)) > [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "link 'palm', <collision>, <geometry>, <mesh>: there is no 'part.stl'"),
        ("solid\nendsolid\n", "holds no triangles"),
        (stl([[[0, 0, 0], [0, 0, "nan"], [1, 0, 0]]]), "not finite"),
        (stl([[[0, 0, 0], [0, 0, 1e37], [1, 0, 0]]]), "not within 10000 m"),
        (stl([[[0, 0, 0], [0, 1e5, 0], [1e5, 1e5, 0]]]), "not within 10000 m"),
    ],
)
def test_broken_meshes_are_one_sentence(changed, content, message):
    pytest.importorskip("trimesh")
    path = changed(('<box size="0.04 0.1 0.04"/>', MESHED))
    if content is not None:
        path.with_name("part.stl").write_text(content)
    with pytest.raises(KinfeasError, match=f"changed.urdf: .*{message}"):
        boxed_urdf(path)


@pytest.mark.parametrize("scale", ["1e16 1e16 1e16", "1 1e16 1"])
@pytest.mark.parametrize("corner", ["1e300 0 0", "1 1 1"])
def test_what_reaches_too_far_is_one_sentence(changed, corner, scale):
    pytest.importorskip("trimesh")
    path = changed(('<box size="0.04 0.1 0.04"/>', f'<mesh filename="a.obj" scale="{scale}"/>'))
    path.with_name("a.obj").write_text(f"v {corner}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(KinfeasError, match=r"<mesh>: .*a\.obj' holds no triangles, or .* 10000 m$"):
        boxed_urdf(path)


def test_what_just_reaches_so_far_is_boxed(changed, tmp_path):
    pytest.importorskip("trimesh")
    path = changed(('<box size="0.04 0.1 0.04"/>', '<mesh filename="a.obj"/>'))
    path.with_name("a.obj").write_text("v 4999 0 0\nv 4998 0 0\nv 0 4999 0\nf 1 2 3\n")
    assert boxed(path, tmp_path).links["palm"].shapes


def test_meshes_need_what_reads_them(meshed, monkeypatch):
    monkeypatch.setattr("kinfeas.importer.boxed.find_spec", lambda name: None)
    with pytest.raises(KinfeasError, match=r"pip install 'kinfeas\[meshes\]'"):
        boxed_urdf(meshed)


def test_only_dae_files_need_what_reads_dae(meshed, monkeypatch):
    pytest.importorskip("trimesh")
    there = "kinfeas.importer.boxed.find_spec"
    monkeypatch.setattr(there, lambda name: None if name == "collada" else name)
    boxed_urdf(meshed)
    meshed.write_text(meshed.read_text().replace("part.stl", "part.dae"))
    meshed.with_name("part.dae").write_text("")
    with pytest.raises(KinfeasError, match=r"pip install 'kinfeas\[meshes\]'"):
        boxed_urdf(meshed)


def test_a_dae_file_counts_in_its_own_unit(changed, cube, tmp_path):
    pytest.importorskip("collada")
    trimesh = pytest.importorskip("trimesh")
    faces = np.arange(36).reshape(-1, 3)
    mesh = trimesh.Trimesh(cube.reshape(-1, 3) * 4.0, faces)
    text = trimesh.exchange.dae.export_collada(mesh).decode()
    assert "<unit" not in text
    assert "</asset>" in text
    scaled = text.replace("</asset>", '<unit name="centimeter" meter="0.01"/></asset>')
    tmp_path.joinpath("part.dae").write_text(scaled)
    path = changed(('<box size="0.04 0.1 0.04"/>', '<mesh filename="part.dae"/>'))
    (shape,) = boxed(path, tmp_path).links["palm"].shapes
    np.testing.assert_allclose(shape.size, 0.041, atol=1e-4)


def test_what_is_seen_stands_in_where_nothing_collides(changed, tmp_path):
    seen = '<link name="tool"><visual><geometry><sphere radius="0.3"/></geometry></visual></link>'
    path = changed(('<link name="tool"/>', seen))
    assert not boxed(path, tmp_path).links["tool"].shapes
    path = changed(('<link name="tool"/>', seen), ("collision>", "visual>"))
    links = boxed(path, tmp_path).links
    assert links["palm"].shapes[0].size == (0.04, 0.1, 0.04)
    assert links["tool"].shapes[0].size == (0.3,)


FLOOR = (
    '<link name="world"/><joint name="slide" type="prismatic"><parent link="world"/>'
    '<child link="base"/><limit lower="-9" upper="9" velocity="1"/></joint>'
)


def test_joints_that_stand_for_a_floor_are_left_out(changed, tmp_path):
    path = changed(('<robot name="dolly">', f'<robot name="dolly">{FLOOR}'))
    assert parse_urdf(path).root == "world"
    urdf = boxed(path, tmp_path)
    assert urdf.root == "base"
    assert "slide" not in urdf.joints


def test_the_base_can_be_chosen(dolly, tmp_path):
    urdf = boxed(dolly, tmp_path, base="upper")
    assert (urdf.root, set(urdf.joints)) == ("upper", {"elbow", "mount", "frame", "l", "r"})
    with pytest.raises(KinfeasError, match="there is no link 'bass'"):
        boxed_urdf(dolly, "bass")


def test_a_link_is_carried_with_all_that_hangs_on_it(dolly):
    assert carried(parse_urdf(dolly), "palm", "") == {"palm", "tool", "left", "right"}


def test_a_lift_above_such_a_floor_belongs_to_the_arm(changed, tmp_path):
    lift = FLOOR.replace('<limit lower="-9"', '<axis xyz="0 0 1"/><limit lower="0"')
    path = changed(('<robot name="dolly">', f'<robot name="dolly">{lift}'))
    assert boxed(path, tmp_path).root == "world"
    slide = (
        '<link name="map"/><joint name="x" type="prismatic"><parent link="map"/>'
        '<child link="world"/><limit lower="-9" upper="9" velocity="1"/></joint>'
    )
    path = changed(('<robot name="dolly">', f'<robot name="dolly">{slide}{lift}'))
    urdf = boxed(path, tmp_path)
    assert urdf.root == "world"
    assert "slide" in urdf.joints


def test_a_first_joint_that_turns_on_a_bare_link_stays(changed, tmp_path):
    turn = FLOOR.replace("prismatic", "continuous").replace("<limit", '<axis xyz="0 0 1"/><limit')
    path = changed(('<robot name="dolly">', f'<robot name="dolly">{turn}'))
    assert boxed(path, tmp_path).root == "world"


def test_xacro_is_one_sentence(changed):
    macro = '<robot xmlns:x="http://www.ros.org/wiki/xacro" name="dolly"><x:include filename="y"/>'
    with pytest.raises(KinfeasError, match="it is xacro and not yet a URDF"):
        boxed_urdf(changed(('<robot name="dolly">', macro)))
