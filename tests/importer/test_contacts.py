import pytest

from kinfeas.importer.arm import find_arm, read_hand
from kinfeas.importer.boxed import boxed_urdf
from kinfeas.importer.draft import stated
from kinfeas.importer.reach import RELEVANT, only_fitted, touching
from kinfeas.robots.loading import build_robot
from kinfeas.robots.urdf_file import parse_urdf

pytest.importorskip("fcl")
trimesh = pytest.importorskip("trimesh")

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
    path.with_name("boxed.urdf").write_text(boxed_urdf(path, originals=originals))
    urdf = parse_urdf(path.with_name("boxed.urdf"))
    arm = find_arm(urdf, None, "dolly")
    spec = stated("dolly", urdf, arm, read_hand(urdf, arm), "differential")
    robot = build_robot(spec, urdf, path, path)
    shares, pair = touching(robot), ("lower", "palm")  # the folded arm brings the palm into lower
    assert shares[pair] > RELEVANT
    found = only_fitted(robot, originals, shares)
    assert (pair in found) == false
    assert found.items() <= shares.items()
    assert not only_fitted(robot, {}, shares)  # nothing was fitted
