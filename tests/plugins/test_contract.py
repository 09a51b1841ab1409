import inspect

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.config import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import FollowsPath
from kinfeas.core.spatial import IDENTITY, compose, distance, integrate, make_pose, relative
from kinfeas.io.demonstrations import Demonstration, write_demonstration
from kinfeas.testing import check_motion_generator
from tests.builders import assert_near, rngs
from tests.plugins.conftest import (
    DT,
    KINDS,
    SHOWN,
    WAYPOINTS,
    run,
    speeds,
    starts_and_targets,
    write_waypoints,
)

GROUP = "kinfeas.motion_generators"
ENDS = {"waypoints": WAYPOINTS[-1], "replay": SHOWN.ee_pose[-1]}
CASES = [
    "linear", "minimum_jerk", "planned", *KINDS,
    *(f"{name} {frame}" for name in ENDS for frame in ("goal", "object", "world")),
]  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """Name of the generator, and the frame of its file if it has one."""
    name, _, frame = request.param.partition(" ")
    return name, frame


@pytest.fixture(scope="module")
def make(case, files):
    name, frame = case
    given = {"frame": frame, "file": files[name]} if frame else {}
    if name in KINDS:
        given = {"model": files[name]}
    return lambda **more: registry.build(GROUP, name, {**given, **more})


@pytest.fixture(scope="module")
def generator(make):
    return make()


def test_keeps_the_contract(generator, case):
    check_motion_generator(generator)
    parameters = inspect.signature(registry.load(GROUP, case[0])).parameters.values()
    assert {parameter.kind for parameter in parameters} == {inspect.Parameter.KEYWORD_ONLY}
    none = np.zeros((0, 7))
    twist, state = generator.twist(generator.start(none, none, []), none, none, np.zeros(0))
    assert twist.shape == (0, 6)
    assert generator.goal_pose(state, none).shape == (0, 7)


@pytest.mark.parametrize(("dt", "n"), [(0.1, 200), (0.5, 10)])
def test_arrives_from_anywhere_finished_for_good_and_comes_back_when_pushed(generator, case, dt, n):
    start, target = starts_and_targets(n, 0)
    goal = generator.goal_pose(generator.start(start, target, [None] * n), target)
    start[0], seen = goal[0], []

    def finished(_, state, poses):
        if isinstance(generator, FollowsPath):
            seen.append(generator.finished(state, target))
            near = distance(poses, goal)[0] < 0.05
            assert np.all(~seen[-1] | near | (case[0] == "gaussian_mixture"))
        return state

    poses, twists, state = run(generator, start, target, 130.0, dt, on_step=finished)
    assert np.max(distance(poses[-1], goal)) < 1e-6
    assert 0.099 < np.max(speeds(twists)) <= 0.1 * (1.0 + 1e-9)
    assert np.abs(twists[-1]).max() < 1e-6
    assert bool(seen) is (case[0] not in {"linear", "minimum_jerk"})
    if seen:
        assert np.all(np.diff(np.array(seen, dtype=int), axis=0) >= 0)
        assert np.all(seen[-1])
        assert not seen[0][1:].any()
    pushed = goal + np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    twist, _ = generator.twist(state, pushed, target, np.full(n, dt))
    assert np.all(np.sum(twist[:, :3] * (goal - pushed)[:, :3], axis=1) > 0.0)


def test_moves_with_its_target_or_stays_in_the_world(generator, case):
    start, target = starts_and_targets(6, 7)
    moved = make_pose(np.array([1.0, -2.0, 0.3]), Rotation.random(rng=3))
    state = generator.start(start, target, [None] * 6)
    if case[1] == "world":
        goals = [generator.goal_pose(state, poses) for poses in (target, compose(moved, target))]
        assert np.array_equal(*goals)
        return
    here, _, _ = run(generator, start, target, 30.0)
    there, _, _ = run(generator, compose(moved, start), compose(moved, target), 30.0)
    assert_near(there, compose(moved, here), 1e-8, 1e-6)
    # A target that moves during the motion is followed to where it stops.
    for i in range(1300):
        now = target + min(i, 100) * np.array([0.005, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        twist, state = generator.twist(state, start, now, np.full(6, DT))
        start = integrate(start, twist, DT)
    assert_near(start, generator.goal_pose(state, now), 1e-6, 1e-6)


@pytest.mark.parametrize("name", ["waypoints", "replay", "spline"])
def test_a_closed_path_passes_the_check_and_is_not_finished_where_it_begins(name, tmp_path):
    angle, circle = np.linspace(0.0, 2.0 * np.pi, 33), np.tile(IDENTITY, (33, 1))
    circle[:, :2] += 0.15 * np.stack([np.cos(angle) - 1.0, np.sin(angle)], axis=1)
    here, path = np.tile(IDENTITY, (33, 1)), tmp_path / "circle.csv"
    if name == "waypoints":
        write_waypoints(path, circle)
    elif name == "replay":
        write_demonstration(Demonstration(np.linspace(0.0, 12.0, 33), circle, here, here), path)
    generator = registry.build(GROUP, name, {} if name == "spline" else {"file": str(path)})
    check_motion_generator(generator)
    target = starts_and_targets(1, 1)[1]
    state = generator.start(target, target, rngs(1))
    assert not generator.finished(state, target)[0]
    poses, _, state = run(generator, target, target, 40.0, state=state)
    assert generator.finished(state, target)[0]
    assert distance(poses[:, 0], target)[0].max() > 0.1


def test_frames_place_the_end(generator, case):
    name, frame = case
    start, target = starts_and_targets(5, 1)
    goal = generator.goal_pose(generator.start(start, target, [None] * 5), target)
    expected = goal if name in KINDS else target
    if frame == "world":
        expected = ENDS[name]
    elif frame == "object":
        origin = SHOWN.object_pose[0] if name == "replay" else IDENTITY
        expected = compose(target, relative(ENDS[name], origin))
    assert_near(goal, expected, 1e-9, 1e-7)


NUMBERS = {
    "linear": ("gain", "min_velocity"),
    "minimum_jerk": ("min_duration",),
    "planned": ("radius", "clearance", "ramp", "min_duration"),
    "imitation": ("gain", "position_scale", "rotation_scale"),
    "waypoints": ("gain", "ramp"),
    "replay": ("gain",),
}


def test_wrong_parameters_raise(make, case):
    for name in (*NUMBERS.get(case[0], ()), "max_velocity", "max_angular_velocity"):
        for value in (0.0, -0.1, np.nan, np.inf, "fast", True):
            with pytest.raises(KinfeasError, match=name):
                make(**{name: value})
    if case[1]:
        with pytest.raises(KinfeasError, match=r"'frame'.*'goal'.*'goals'"):
            make(frame="goals")
        with pytest.raises(KinfeasError, match=r"none\.csv"):
            make(file="none.csv")
