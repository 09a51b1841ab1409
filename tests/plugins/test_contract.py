import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import FollowsPath
from kinfeas.core.spatial import IDENTITY, compose, integrate, make_pose, relative
from kinfeas.io.demonstrations import Demonstration, write_demonstration
from kinfeas.testing import check_motion_generator
from tests.builders import assert_near, rngs
from tests.plugins.conftest import (
    DT,
    SHOWN,
    WAYPOINTS,
    apart,
    circle,
    run,
    speeds,
    starts_and_targets,
    write_waypoints,
)

GROUP = "kinfeas.motion_generators"
TARGET_FRAMES = ("goal", "object")


@dataclass(frozen=True)
class Case:
    """A generator, its parameters, and the fixtures of those that name files."""

    name: str
    frame: str = ""
    model: str = ""
    file: str = ""

    def __str__(self):
        return f"{self.name} {self.frame}".strip()


CASES = [
    Case("linear"),
    Case("minimum_jerk"),
    Case("planned"),
    Case("imitation", model="imitation"),
    Case("gaussian_mixture", model="gaussian_mixture"),
    *(Case("waypoints", frame, file="waypoints") for frame in (*TARGET_FRAMES, "world")),
    *(Case("replay", frame, file="shown") for frame in (*TARGET_FRAMES, "world")),
]


@pytest.fixture(scope="module", params=CASES, ids=str)
def case(request):
    return request.param


@pytest.fixture(scope="module")
def make(case, models, files):
    given = {"model": models.get(case.model), "file": files.get(case.file), "frame": case.frame}
    given = {key: value for key, value in given.items() if value}
    return lambda **more: registry.build(GROUP, case.name, {**given, **more})


@pytest.fixture(scope="module")
def generator(make):
    return make()


def test_keeps_the_contract(generator, case):
    check_motion_generator(generator)
    kinds = {p.kind for p in inspect.signature(registry.load(GROUP, case.name)).parameters.values()}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize(("dt", "n"), [(0.1, 200), (0.5, 10)])
def test_arrives_from_anywhere_within_its_limits_and_comes_back_when_pushed(generator, dt, n):
    start, target = starts_and_targets(n, 0)
    poses, twists, state = run(generator, start, target, 130.0, dt)
    goal = generator.goal_pose(state, target)
    assert np.max(apart(poses[-1], goal)) < 1e-6
    fastest = np.max(speeds(twists))
    assert 0.099 < fastest <= 0.1 * (1.0 + 1e-9)
    assert np.abs(twists[-1]).max() < 1e-6
    pushed = goal + np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    twist, _ = generator.twist(state, pushed, target, np.full(n, dt))
    assert np.all(np.sum(twist[:, :3] * (goal - pushed)[:, :3], axis=1) > 0.0)


def test_motions_do_not_depend_on_the_rate(generator):
    start, target = starts_and_targets(6, 2)
    fine, coarse = (run(generator, start, target, 40.0, dt)[0] for dt in (0.02, 0.1))
    assert_near(fine[::5], coarse, 0.1, 0.3)


def test_a_motion_has_the_same_bits_whatever_the_others_and_their_rates_are(generator):
    start, target = starts_and_targets(6, 5)
    start[4] = target[4]
    dt, steps = np.array([0.1, 0.02, 0.1, 0.5, 0.02, 0.1]), 100
    state, poses = generator.start(start, target, [None] * 6), [start]
    for _ in range(steps):
        twist, state = generator.twist(state, poses[-1], target, dt)
        poses.append(integrate(poses[-1], twist, dt))
    for row, seconds in enumerate(dt.tolist()):
        one = slice(row, row + 1)
        alone, _, after = run(generator, start[one], target[one], steps * seconds, seconds)
        assert np.array_equal(alone[:, 0], np.stack(poses)[:, row])
        assert all(np.array_equal(after[key][0], values[row]) for key, values in state.items())
    none = np.zeros((0, 7))
    twist, state = generator.twist(generator.start(none, none, []), none, none, np.zeros(0))
    assert twist.shape == (0, 6)
    assert generator.goal_pose(state, none).shape == (0, 7)


def test_moves_with_its_target_or_stays_in_the_world(generator, case):
    start, target = starts_and_targets(6, 7)
    turn = make_pose(np.array([1.0, -2.0, 0.3]), Rotation.random(rng=3))
    moved = np.repeat(turn[np.newaxis], 6, axis=0)
    state = generator.start(start, target, [None] * 6)
    if case.frame == "world":
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
    metres, radians = apart(start, generator.goal_pose(state, now))
    assert max(metres.max(), radians.max()) < 1e-6


OWN_PATH = ("planned", "imitation", "gaussian_mixture", "waypoints", "replay")


def test_motions_with_a_path_of_their_own_are_finished_at_its_end_for_good(generator, case):
    assert isinstance(generator, FollowsPath) == (case.name in OWN_PATH)
    if case.name not in OWN_PATH:
        return
    start, target = starts_and_targets(6, 3)
    start[0] = generator.goal_pose(generator.start(start, target, [None] * 6), target)[0]
    seen = []

    def finished(i, state, poses):
        seen.append(generator.finished(state, target))
        near = apart(poses, generator.goal_pose(state, target))
        assert np.all(~seen[-1] | (case.name == "gaussian_mixture") | (near[0] < 0.05))
        return state

    run(generator, start, target, 130.0, on_step=finished)
    assert np.all(np.diff(np.array(seen, dtype=int), axis=0) >= 0)
    assert np.all(seen[-1])
    assert not seen[0][1:].any()


@pytest.mark.parametrize("name", ["waypoints", "replay", "spline"])
def test_a_closed_path_passes_the_check_and_is_not_finished_where_it_begins(name, tmp_path):
    given = {}
    if name == "waypoints":
        given["file"] = write_waypoints(tmp_path / "circle.csv", circle())
    elif name == "replay":
        time = np.linspace(0.0, 12.0, 33)
        given["file"] = str(tmp_path / "circle.csv")
        here = np.tile(IDENTITY, (33, 1))
        write_demonstration(Demonstration(time, circle(), here, here), tmp_path / "circle.csv")
    generator = registry.build(GROUP, name, given)
    check_motion_generator(generator)
    target = starts_and_targets(1, 1)[1]
    state = generator.start(target, target, rngs(1))
    assert not generator.finished(state, target)[0]
    poses, _, state = run(generator, target, target, 40.0, state=state)
    assert generator.finished(state, target)[0]
    assert apart(poses[:, 0], target)[0].max() > 0.1


ENDS = {"waypoints": WAYPOINTS[-1], "replay": SHOWN.ee_pose[-1]}


def test_frames_place_the_end(generator, case):
    start, target = starts_and_targets(5, 1)
    goal = generator.goal_pose(generator.start(start, target, [None] * 5), target)
    if case.frame in ("", "goal"):
        expected = target if not case.model else goal
    elif case.frame == "world":
        expected = np.repeat(ENDS[case.name][np.newaxis], 5, axis=0)
    else:
        end, origin = ENDS[case.name], SHOWN.object_pose[0]
        in_object = end if case.name == "waypoints" else relative(end, origin)
        expected = compose(target, np.repeat(in_object[np.newaxis], 5, axis=0))
    assert np.allclose(relative(goal, expected), IDENTITY, atol=1e-9)


NUMBERS = {
    "linear": ("gain", "min_velocity"),
    "minimum_jerk": ("min_duration",),
    "planned": ("radius", "clearance", "ramp", "min_duration"),
    "imitation": ("gain", "position_scale", "rotation_scale"),
    "waypoints": ("gain", "ramp"),
    "replay": ("gain",),
}


def test_wrong_parameters_raise(make, case):
    for name in (*NUMBERS.get(case.name, ()), "max_velocity", "max_angular_velocity"):
        for value in (0.0, -0.1, np.nan, np.inf, "fast", True):
            with pytest.raises(KinfeasError, match=name):
                make(**{name: value})
    if case.frame:
        with pytest.raises(KinfeasError, match=r"'frame'.*'goal'.*'goals'"):
            make(frame="goals")
        with pytest.raises(KinfeasError, match=r"none\.csv"):
            make(file="none.csv")
