import sys

import numpy as np
import pytest

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.stage import Stage
from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.physics import ROOT, Physics
from kinfeas.core.errors import KinfeasError
from kinfeas.scenes.scene import read_scene
from kinfeas.tasks.loading import load_task
from tests.backends.conftest import place, stay


@pytest.fixture
def physics():
    world = Physics(PhysicsConfig())
    yield world
    world.close()


def test_a_control_period_has_a_whole_number_of_steps(physics):
    for dt, steps in ((0.02, 5), (0.1, 24), (1 / 240, 1), (0.001, 1)):
        assert physics.divide(dt) == steps
        assert physics.step_time == dt / steps
    for dt in (0.0, -0.02, float("nan"), float("inf")):
        with pytest.raises(KinfeasError, match="control period"):
            physics.divide(dt)


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


@pytest.mark.parametrize("display", ["", ":77"])
def test_a_window_without_a_screen_is_an_error(monkeypatch, display, capfd):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(KinfeasError, match=f"DISPLAY={display}$"):
        Physics(PhysicsConfig(), gui=True)
    assert capfd.readouterr() == ("", "")


@pytest.fixture(scope="module")
def room_world(hsr):
    world = PyBulletBackend(hsr, read_scene("room"))
    yield world
    world.close()


# The place table is 0.52 m high at (0.25, -2.75), one of its legs ends at x = 0.58, y = -2.42.
@pytest.mark.parametrize(("pose", "stands"), [
    ([0.25, -2.75, 0.636, 0.0, 0.0, 0.0, 1.0], True),
    ([0.25, -2.75, 0.636, 0.0, 0.0, 0.7071, 0.7071], True),
    ([0.25, -2.75, 0.60, 0.7071, 0.0, 0.0, 0.7071], False),  # on its side
    ([0.25, -2.75, 0.90, 0.0, 0.0, 0.0, 1.0], False),  # still falling
    ([0.6295, -2.42, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor, touching a leg
    ([-0.5, -2.0, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor
])  # fmt: skip
def test_an_object_stands_if_upright_at_rest_on_another(room_world, pose, stands):
    sim = room_world.sims[0]
    place(room_world)
    box, table = (sim.furniture.bodies[name] for name in ("box", "place_table"))
    sim.physics.place(box, np.array(pose) / [1, 1, 1, *[np.linalg.norm(pose[3:])] * 4])
    stay(room_world, 5 if pose[2] == 0.90 else 100)
    if pose[0] == 0.6295:
        assert sim.physics.client.getContactPoints(bodyA=box, bodyB=table)
    stage = Stage(load_task("ggr"), room_world)
    assert stage.stands(0, "box", "place_table") is stands
    sim.physics.client.resetBaseVelocity(box, [0.2, 0.0, 0.0])
    assert not stage.stands(0, "box", "place_table")


@pytest.fixture
def grasped(world, begin, between_fingers):
    begin(bar=between_fingers)
    sim = world.sims[0]
    sim.physics.client.setGravity(0.0, 0.0, 0.0)
    bar = sim.furniture.link("bar", "bar")
    sim.gripper.move("close")
    for _ in range(40):
        stay(world, 1)
        if sim.grasp.hold(*bar):
            break
    sim.physics.client.setGravity(0.0, 0.0, -9.81)
    assert sim.grasp.held == bar
    return sim


def test_a_grasp_needs_both_fingers(world, begin, grasped, monkeypatch):
    wall = grasped.furniture.bodies["wall"]
    assert grasped.gripper.touching(wall, ROOT) == frozenset()
    begin()
    assert grasped.grasp.held is None
    assert grasped.furniture.link_pose("bar", "bar")[0] == pytest.approx(3.0)
    for fingers in ((), (0,), (1,)):
        monkeypatch.setattr(grasped.gripper, "touching", lambda *_, some=fingers: {*some})
        assert not grasped.grasp.hold(*grasped.furniture.link("bar", "bar"))
    assert grasped.grasp.held is None


def test_the_grasp_carries_the_weight_until_it_is_released(world, grasped):
    grasped.gripper.move("open")
    stay(world, 60)
    assert grasped.grasp.force == pytest.approx(0.3 * 9.81, rel=0.05)
    grasped.grasp.release()
    stay(world, 40)
    assert grasped.grasp.held is None
    assert grasped.furniture.link_pose("bar", "bar")[2] < 0.25


def test_the_grasp_breaks_above_its_limit(world, grasped):
    bar, _ = grasped.furniture.link("bar", "bar")
    stay(world, 20)
    assert grasped.grasp.held is not None
    client = grasped.physics.client
    for _ in range(20):  # a force lasts one physics step
        at = grasped.furniture.link_pose("bar", "bar")[:3].tolist()
        client.applyExternalForce(bar, -1, [0.0, 0.0, 400.0], at, client.WORLD_FRAME)
        stay(world, 1, dt=1 / 240)
    assert grasped.grasp.held is None
