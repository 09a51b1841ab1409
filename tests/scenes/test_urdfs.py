"""The shipped furniture moves freely, and PyBullet reads the same links and joints."""

import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, distance
from kinfeas.robots.urdf_file import parse_urdf
from kinfeas.scenes import scene as scenes
from kinfeas.scenes.check import Solids
from kinfeas.scenes.objects import SceneObject, rest_positions

URDFS = sorted(scenes._FOLDER.glob("*.urdf"))
MOVING = [("shelf_with_door", "hinge", 1.92), ("shelf_with_drawer", "slide", 0.35)]
PLAY = 3e-3  # m, that stays between what moves and what does not


def loaded(path, **positions):
    urdf = parse_urdf(path)
    return SceneObject(path, urdf, IDENTITY, True, rest_positions(urdf, positions))


def parts(name, **positions):
    """Return the shapes of the body and those of what moves."""
    shapes = list(loaded(scenes._FOLDER / f"{name}.urdf", **positions).shapes())
    return [s for link, s in shapes if link == "body"], [s for link, s in shapes if link != "body"]


@pytest.mark.parametrize(("name", "joint", "upper"), MOVING)
def test_doors_and_drawers_open_all_the_way_without_touching_their_body(name, joint, upper):
    for position in np.linspace(0.0, upper, 60):
        body, moved = parts(name, **{joint: position})
        assert not Solids(body, -PLAY).touches(Solids(moved)), position


@pytest.fixture(scope="module")
def bullet():
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.stem)
def test_pybullet_reads_the_same_masses_joints_and_places(bullet, path):
    import pybullet

    positions = {name: 0.2 for name in parse_urdf(path).joints if name in ("hinge", "slide")}
    one = loaded(path, **positions)
    body = pybullet.loadURDF(str(path), physicsClientId=bullet)
    links = {one.urdf.root: -1}
    for number in range(pybullet.getNumJoints(body, bullet)):
        info = pybullet.getJointInfo(body, number, bullet)
        links[info[12].decode()] = number
        joint = one.urdf.joints[info[1].decode()]
        if joint.moves:
            assert (info[8], info[9]) == pytest.approx((joint.lower, joint.upper))
            assert (info[6], info[7]) == pytest.approx((joint.damping, joint.friction))
            pybullet.resetJointState(body, number, one.joint_positions[joint.name], 0.0, bullet)
    assert set(links) == set(one.urdf.links)
    poses = one.link_poses()
    for name, number in links.items():
        dynamics = pybullet.getDynamicsInfo(body, number, bullet)
        assert dynamics[0] == pytest.approx(one.urdf.links[name].mass)
        assert min(dynamics[2]) > 0.0
        assert len(pybullet.getCollisionShapeData(body, number, bullet)) == len(
            one.urdf.links[name].shapes
        )
        if number >= 0:
            state = pybullet.getLinkState(body, number, True, True, bullet)
            seen = np.array([*state[4], *state[5]])
            metres, radians = distance(seen, poses[name])
            assert metres < 1e-6
            assert radians < 1e-6
