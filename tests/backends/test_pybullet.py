import os
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("pybullet")

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.errors import KinfeasError


@pytest.fixture
def physics():
    world = Physics(PhysicsConfig())
    yield world
    world.close()


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("mesh", ["none.stl", "text.stl"])
def test_an_unreadable_mesh_is_an_error_of_one_line(physics, tmp_path, capfd, kind, mesh):
    (tmp_path / "text.stl").write_text("solid a\nendsolid a\n")
    shape = f"<{kind}><geometry><mesh filename='{mesh}'/></geometry></{kind}>"
    path = tmp_path / "thing.urdf"
    path.write_text(f"<robot name='a'><link name='a'>{shape}</link></robot>")
    with pytest.raises(KinfeasError, match=rf"thing\.urdf: .*{mesh}") as caught:
        physics.load(path, fixed=False)
    assert "\n" not in str(caught.value)
    with pytest.raises(KinfeasError, match=r"thing\.urdf"):
        physics.load(path, path.read_text(), fixed=True)
    assert capfd.readouterr() == ("", "")
    physics.save()
    physics.restore()


def test_links_may_be_listed_before_their_parents(physics, tmp_path):
    inertia = (
        "<inertial><mass value='1'/>"
        "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"
    )
    links = [f"<link name='{name}'>{inertia}</link>" for name in "abc"]
    joints = "".join(
        f"<joint name='{p}{c}' type='continuous'><parent link='{p}'/><child link='{c}'/>"
        "<origin xyz='1 0 0'/><axis xyz='0 0 1'/></joint>" for p, c in ("ab", "bc")
    )  # fmt: skip
    inertias = []
    for number, order in enumerate((links, links[::-1])):
        path = tmp_path / f"{number}.urdf"
        path.write_text(f"<robot name='r'>{''.join(order)}{joints}</robot>")
        body = physics.load(path, fixed=True)
        assert list(physics.joints(body)) == ["ab", "bc"]
        inertias.append(physics.client.calculateMassMatrix(body, [0.0, 0.0]))
    assert inertias[0] == inertias[1]


def test_worlds_built_in_several_threads_leave_the_output_as_it_is():
    before = os.fstat(1)
    with ThreadPoolExecutor(4) as pool:
        for world in pool.map(Physics, [PhysicsConfig()] * 16):
            world.close()
    assert os.path.samestat(os.fstat(1), before)


@pytest.mark.parametrize("display", ["", ":77"])
def test_a_window_without_a_screen_is_an_error(monkeypatch, display, capfd):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(KinfeasError, match=f"DISPLAY={display}$"):
        Physics(PhysicsConfig(), gui=True)
    assert capfd.readouterr() == ("", "")
