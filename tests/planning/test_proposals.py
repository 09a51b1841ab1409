import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import IDENTITY, compose, distance, make_pose, planar_pose
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.planning.proposals import propose

TURN = Rotation.from_rotvec([0.1, 0.1, 0.1])


def test_bases_of_short_arms_move_to_where_the_arm_reaches(hsr):
    chain, rng, near, seconds = build_chain(hsr), np.random.default_rng(0), 20, 0.5
    joints, commands = hsr.home["home"][np.newaxis], rng.uniform(-0.3, 0.3, (1, 2 * near, 3))
    target = compose(forward(chain, joints), make_pose(np.full(3, 0.02), TURN))[0]
    limits, step = (hsr.base.max_velocity, hsr.base.max_rotation), hsr.max_joint_velocity * seconds
    base = IDENTITY[np.newaxis]
    found = propose(chain, base, joints, commands, near, target, step, limits, seconds)
    reached = compose(planar_pose(*found.base[0].T), forward(chain, found.joints[0]))
    assert distance(reached[near:], target)[0].max() < 0.012
