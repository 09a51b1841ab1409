import pytest

from kinfeas.scenes.scene import read_scene

TABLE_ALONE = """
name: mine
size: [4.0, 3.0]
objects:
  table: {urdf: table.urdf, position: [1.0, 0.0, 0.0]}
  shelf: {urdf: shelf_with_door.urdf, position: [-1.0, 0.0, 0.4]}
handles:
  door: {object: shelf, link: handle}
"""


@pytest.fixture(scope="session")
def room():
    return read_scene("room")


@pytest.fixture
def write(tmp_path):
    """A function that writes a user's scene, with one text in it replaced by another."""

    def write_scene(old="", new="", text=TABLE_ALONE):
        assert old in text
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace(old, new, 1) if old else text)
        return str(path)

    return write_scene
