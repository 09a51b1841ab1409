import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.scenes.scene import read_scene

SCENE = "{name: own, size: [4, 4], objects: {thing: {urdf: thing.urdf, position: [1, 0, 0.5]}}}"
BOX = "<collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
JOINT = "<joint name='j' type='{kind}'><parent link='a'/><child link='b'/><axis xyz='1 0 0'/>"
JOINT += "<limit lower='0' upper='1'/></joint>"


def inertial(mass="1", ixx="1", iyy="1", izz="1", ixy="0"):
    moments = f"ixx='{ixx}' iyy='{iyy}' izz='{izz}' ixy='{ixy}' ixz='0' iyz='0'"
    return f"<inertial><mass value='{mass}'/><inertia {moments}/></inertial>"


@pytest.fixture
def read(tmp_path):
    """A function that reads a scene with one thing of one or two links."""

    def read_thing(root, child=None, kind="prismatic", fixed=False):
        links = f"<link name='a'>{BOX}{root}</link>"
        if child is not None:
            links += f"<link name='b'>{child}</link>{JOINT.format(kind=kind)}"
        (tmp_path / "thing.urdf").write_text(f"<robot name='r'>{links}</robot>")
        path = tmp_path / "own.yaml"
        path.write_text(SCENE)
        return read_scene(str(path), [f"objects.thing.fixed={str(fixed).lower()}"])

    return read_thing


@pytest.mark.parametrize(
    ("root", "message"),
    [
        ("", "<inertial> is missing"),
        (inertial(mass="0"), "its mass must be above 0"),
        (inertial(ixx="0", iyy="0", izz="0"), "all principal moments of inertia must be above 0"),
        (inertial(ixy="2"), "all principal moments of inertia must be above 0"),
        (inertial(ixx="1", iyy="0.1", izz="0.1"), "of inertia, 1, must be at most .* two, 0.2$"),
    ],
)
def test_what_can_move_needs_an_inertia(read, root, message):
    with pytest.raises(KinfeasError, match=rf"thing\.urdf: link 'a': it can move, and .*{message}"):
        read(root)
    with pytest.raises(KinfeasError, match=rf"thing\.urdf: link 'b': it can move, and .*{message}"):
        read(inertial(), root, fixed=True)
    read(root, fixed=True)


def test_bodies_that_there_are_pass(read):
    read(inertial())
    read(inertial(ixx="2", iyy="1", izz="1"))  # a plate
    read(inertial(), inertial(mass="0"), kind="fixed")  # a frame on it


def test_a_frame_that_moves_alone_is_refused(read):
    with pytest.raises(KinfeasError, match="link 'b': it can move, and its mass must be above 0"):
        read(inertial(), inertial(mass="0"))
