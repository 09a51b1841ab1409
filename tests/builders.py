"""Poses, random numbers and comparisons that many tests share."""

import time
from itertools import pairwise

import numpy as np

from kinfeas.control import observation
from kinfeas.core.spatial import canonical, distance, planar_pose
from kinfeas.kinematics import drive
from kinfeas.policies.network import Network

TIMEOUT = 300.0
"""Seconds that a busy machine may take to start a process and to compile its kernels."""


def wait(condition):
    """Wait until a condition holds; fail after `TIMEOUT`."""
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)


def assert_near(poses, expected, metres, radians):
    """Check that poses are at most so far apart; `expected` may be one pose for all."""
    apart = [np.max(part) for part in distance(poses, np.broadcast_to(expected, poses.shape))]
    assert np.all(np.array(apart) <= [metres, radians]), apart


def at(x=0.0, y=0.0, yaw=0.0):
    """Return one base pose, shape (1, 7)."""
    return planar_pose(*np.array([[x], [y], [yaw]], dtype=float))


def twist(x=0.0, y=0.0, turn=0.0):
    """Return one planar twist, shape (1, 6)."""
    return np.array([[x, y, 0.0, 0.0, 0.0, turn]])


def rngs(n, seed=0):
    return [np.random.default_rng((seed, i)) for i in range(n)]


def random_poses(shape, seed=0, reach=1.0):
    """Return poses in a cube of twice `reach`, in any orientation, shape (*shape, 7)."""
    rng, shape = np.random.default_rng(seed), np.atleast_1d(shape).tolist() if shape != () else []
    pose = np.concatenate(
        [rng.uniform(-reach, reach, (*shape, 3)), rng.normal(size=(*shape, 4))], -1
    )
    pose[..., 3:] /= np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)
    pose[..., 3:] = canonical(pose[..., 3:])
    return pose


def random_bases(n, seed=0):
    """Return base poses in a square of 4 m, in any heading, shape (n, 7)."""
    rng = np.random.default_rng(seed)
    return planar_pose(*rng.uniform(-2.0, 2.0, (2, n)), rng.uniform(-np.pi, np.pi, n))


def contents(folder):
    """Return the bytes of all files below a folder, by path."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def random_network(robot, width=256):
    """Return an untrained network of two hidden layers for a robot."""
    rng = np.random.default_rng(0)
    sizes = (observation.size(robot), width, width, drive.command_size(robot.base))
    return Network(
        scale=observation.scale(robot).astype(np.float32),
        weights=tuple(
            rng.normal(0.0, (2.0 / rows) ** 0.5, (rows, columns)).astype(np.float32)
            for rows, columns in pairwise(sizes)
        ),
        biases=tuple(np.zeros(columns, dtype=np.float32) for columns in sizes[1:]),
    )


class KilledError(BaseException):
    """Stands for a kill: nothing catches it."""


def kill():
    raise KilledError


def stop_at(monkeypatch, owner, name, call, stop=kill):
    """Let `stop` happen within the n-th call of a function."""
    function, calls = getattr(owner, name), []

    def stopped(*arguments, **options):
        calls.append(1)
        if len(calls) == call:
            stop()
        return function(*arguments, **options)

    monkeypatch.setattr(owner, name, stopped)


TRAINING = {
    "num_envs": 8, "learner.batch_size": 16, "learner.net_arch": [8], "learner.buffer_size": 1000,
    "learner.learning_starts": 16, "schedule.evaluations": 1, "schedule.evaluation_episodes": 2,
    "schedule.final_episodes": 2, "learner.gradient_steps": 1,
}  # fmt: skip
"""Settings of a training that takes a second."""
