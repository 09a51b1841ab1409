import sys

import numpy as np
import pytest

from kinfeas.backends.pybullet.physics import Physics, PhysicsConfig
from kinfeas.core.errors import KinfeasError


@pytest.fixture
def physics():
    world = Physics(PhysicsConfig())
    yield world
    world.close()


@pytest.mark.parametrize(("dt", "steps"), [(0.02, 5), (0.1, 24), (1 / 240, 1), (0.001, 1)])
def test_a_control_period_holds_a_whole_number_of_steps(physics, dt, steps):
    assert physics.divide(dt) == steps
    assert physics.step_time == dt / steps


@pytest.mark.parametrize("dt", [0.0, -0.02, float("nan"), float("inf")])
def test_refuses_other_periods(physics, dt):
    with pytest.raises(KinfeasError, match="the control period must be above 0 s and finite"):
        physics.divide(dt)


def test_can_be_closed_twice_and_leaves_the_next_world_alone():
    physics = Physics(PhysicsConfig())
    physics.close()
    other = Physics(PhysicsConfig())
    physics.close()
    with pytest.raises(KinfeasError, match="Not connected"), physics.connected():
        physics.client.stepSimulation()
    other.client.stepSimulation()
    other.close()


def test_what_is_placed_is_there_although_its_mass_is_elsewhere(physics, scene):
    body = physics.load(scene.objects["wall"].urdf_path, fixed=True)
    pose = np.array([1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5])
    physics.place(body, pose)
    np.testing.assert_allclose(physics.link_pose(body, -1), pose, atol=1e-12)
    assert np.abs(physics.mass_pose(body, -1)[:3] - pose[:3]).max() > 0.1


def test_what_pybullet_cannot_load_is_one_sentence(physics, tmp_path, capfd):
    mesh = "<visual><geometry><mesh filename='none.stl'/></geometry></visual>"
    path = tmp_path / "thing.urdf"
    path.write_text(f"<robot name='a'><link name='a'>{mesh}</link></robot>")
    message = r"thing\.urdf: PyBullet cannot load it: .*none\.stl"
    with pytest.raises(KinfeasError, match=message) as caught:
        physics.load(path, fixed=False)
    assert "\n" not in str(caught.value)
    with pytest.raises(KinfeasError, match=message):
        physics.load_text(path.read_text(), path)
    assert capfd.readouterr() == ("", "")
    physics.save()
    physics.restore()


def test_says_so_where_there_is_no_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(KinfeasError, match=r"the PyBullet world needs Python 3\.11"):
        Physics(PhysicsConfig())


def test_starts_without_a_word(capfd):
    Physics(PhysicsConfig()).close()
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_furniture_without_an_inertia_is_loaded_without_a_word(physics, tmp_path, capfd):
    shape = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
    path = tmp_path / "thing.urdf"
    path.write_text(f"<robot name='a'><link name='a'>{shape}</link></robot>")
    physics.load(path, fixed=True)
    assert capfd.readouterr() == ("", "")
