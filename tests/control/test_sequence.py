import numpy as np
import pytest

from kinfeas.control.execution import ExecutionConfig, SubgoalMotion, tool_pose
from kinfeas.control.observation import HORIZON
from kinfeas.control.sequence import MotionSequence
from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.kinematics.ik import IkSolver
from kinfeas.plugins.linear import Linear
from kinfeas.plugins.waypoints import Waypoints
from tests.builders import random_poses

FAR = np.zeros(1, dtype=bool)  # from where a grip needs the EE


class Wander:
    """Moves toward a point near the target that it draws, and counts; the base was shown, too."""

    def start(self, ee_pose, target_pose, rngs):
        goal = target_pose.copy()
        goal[:, :3] += np.array([rng.uniform(-0.1, 0.1, 3) for rng in rngs])
        return {"goal": goal, "count": np.zeros(len(goal)), "begin": ee_pose.copy()}

    def goal_pose(self, state, target_pose):
        return state["goal"].copy()

    def twist(self, state, ee_pose, target_pose, dt):
        way = spatial.twist_between(ee_pose, state["goal"], 1.0)
        return 0.5 * way, {**state, "count": state["count"] + 1.0}

    def base_pose(self, state, target_pose):
        pose = np.tile(spatial.IDENTITY, (len(state["count"]), 1))
        pose[:, 0] = state["count"]
        return pose


def rngs(rows, seed=0):
    return [np.random.default_rng((seed, row)) for row in rows]


def chain():
    """Return four sub-goals of two generators and both frames, with and without a wait."""
    linear = Linear()
    return [
        SubgoalMotion(linear, "tip"),
        SubgoalMotion(Wander(), "ee", dwell=0.3),
        SubgoalMotion(linear, "ee"),
        SubgoalMotion(linear, "tip", dwell=5.0),
    ]


def begin(robot, n=6, subgoals=None, dt=HORIZON, **execution):
    subgoals = chain() if subgoals is None else subgoals
    sequence = MotionSequence(subgoals, IkSolver(robot), dt, ExecutionConfig(**execution))
    targets = random_poses(n * len(subgoals), 1).reshape(n, len(subgoals), 7)
    sequence.start(random_poses(n), targets, rngs(range(n)))
    return sequence


def follow(sequence, steps, arrived=None):
    """Move on, arriving where a row is near or as told, and return all desired poses."""
    seen = []
    for i in range(steps):
        sequence.move(sequence.step_of(HORIZON))
        metres, radians = spatial.distance(sequence.desired, sequence.goal)
        near = (metres < 0.02) & (radians < 0.2)
        sequence.end_subgoals(near if arrived is None else arrived(i), FAR)
        seen.append(sequence.desired)
    return np.stack(seen)


def test_the_tip_moves_straight_and_takes_the_ee_along(robot):
    sequence, linear = begin(robot, subgoals=[SubgoalMotion(Linear(), "tip")]), Linear()
    tool = np.broadcast_to(tool_pose(robot), (6, 7))
    tip = spatial.compose(sequence.desired, tool)
    state = linear.start(tip, random_poses(6, 1), rngs(range(6)))
    for _ in range(100):
        twist, state = linear.twist(state, tip, random_poses(6, 1), np.full(6, HORIZON))
        tip = spatial.integrate(tip, twist, HORIZON)
        sequence.move(sequence.step_of(HORIZON))
        error = spatial.distance(spatial.compose(sequence.desired, tool), tip)
        np.testing.assert_allclose(np.stack(error), 0.0, atol=1e-6)


@pytest.mark.parametrize(("dt", "periods"), [(0.1, 12), (0.02, 56), (0.3, 4)])
def test_a_dwell_keeps_its_time(robot, dt, periods):
    linear = Linear()
    subgoals = [SubgoalMotion(linear, dwell=1.12), SubgoalMotion(linear)]
    sequence = begin(robot, 2, subgoals, dt, grasp_settle_time=1.0)  # they have no grip
    sequence.move(sequence.step_of(dt))
    sequence.end_subgoals(np.array([True, False]), FAR)
    assert sequence.dwelling.tolist() == [periods, 0]
    stood = sequence.desired[0]
    for i in range(periods):
        assert sequence.subgoal[0] == 0
        np.testing.assert_array_equal(sequence.step_of(HORIZON).desired[0], stood)
        before = sequence.desired
        sequence.move(sequence.step_of(dt))
        np.testing.assert_array_equal(sequence.desired[0], stood)
        assert np.linalg.norm(sequence.desired[1] - before[1]) > 0.0
        sequence.end_subgoals(np.array([i % 2 == 0, False]), FAR)
    assert sequence.subgoal.tolist() == [1, 0]
    sequence.move(sequence.step_of(dt))
    assert np.linalg.norm(sequence.desired[0] - stood) > 0.0


def test_a_restart_is_the_same_in_any_row_and_touches_no_other(robot):
    whole, other = begin(robot, 6), begin(robot, 6)
    follow(whole, 300)
    follow(other, 300)
    paused = other.snapshot()
    copies = {key: values.copy() for key, values in paused.items()}
    rows = np.array([3, 1])
    other.start(
        random_poses(6)[[0, 5]], random_poses(24, 1).reshape(6, 4, 7)[[0, 5]], rngs([0, 5]), rows
    )
    for key, values in paused.items():
        np.testing.assert_array_equal(values, copies[key], err_msg=key)
    kept = [0, 2, 4, 5]
    seen = follow(other, 300)
    np.testing.assert_array_equal(seen[:, kept], follow(whole, 300)[:, kept])
    np.testing.assert_array_equal(seen[:, rows], follow(begin(robot, 6), 300)[:, [0, 5]])


@pytest.mark.parametrize("subgoal", range(4))
def test_snapshot_goes_on_to_the_bit(robot, subgoal):
    sequence, again = begin(robot), MotionSequence(chain(), IkSolver(robot), HORIZON)
    follow(sequence, 1)
    while not np.any(sequence.subgoal == subgoal):
        follow(sequence, 1)
    again.restore(sequence.snapshot())
    for key in ("subgoal", "dwelling", "goal", "demonstrated_base"):
        np.testing.assert_array_equal(getattr(again, key), getattr(sequence, key))
    np.testing.assert_array_equal(follow(again, 500), follow(sequence, 500))


def test_the_demonstrated_base_is_given_on_its_subgoals_only(robot):
    sequence = begin(robot, 3, [SubgoalMotion(Wander()), SubgoalMotion(Linear())])
    follow(sequence, 5, lambda _: np.array([False, True, False]))
    base = sequence.demonstrated_base
    np.testing.assert_array_equal(base[[0, 2], 0], 5.0)
    assert np.isnan(base[1]).all()


def test_a_head_start_delays_the_first_subgoal_only(robot):
    subgoals = [SubgoalMotion(Linear(), dwell=0.2), SubgoalMotion(Linear())]
    sequence = begin(robot, 2, subgoals, head_start=0.5)
    seen = follow(sequence, 8, lambda i: np.array([i == 6, False]))
    assert np.all(seen[:5] == random_poses(2))
    assert np.all(np.any(seen[5] != seen[4], axis=1))
    assert sequence.dwelling.tolist() == [1, 0]
    follow(sequence, 1, lambda _: np.array([False, False]))
    assert sequence.subgoal.tolist() == [1, 0]


@pytest.mark.parametrize(("settled_at", "stops_at"), [(2, 2), (0, 0), (99, 4)])
def test_a_subgoal_that_ends_with_a_grip_goes_on_until_it_settles(robot, settled_at, stops_at):
    close, finish = (SubgoalMotion(Linear(), dwell=0.3, grip=grip) for grip in ("close", "open"))
    sequence = begin(robot, 1, [close, finish], time_scale=0.5, grasp_settle_time=0.2)
    stops, moves = [], []
    for i in range(7):
        before = sequence.desired
        sequence.move(sequence.step_of(HORIZON))
        moves.append(bool(np.any(sequence.desired != before)))
        stops.append(
            bool(sequence.end_subgoals(np.ones(1, dtype=bool), np.array([i >= settled_at]))[0])
        )
    assert stops == [i == stops_at for i in range(7)]
    assert moves[: stops_at + 4] == ([True] * (stops_at + 1) + [False] * 3)[: len(moves)]


class Wary(Wander):
    def start(self, ee_pose, target_pose, rngs):
        return {**super().start(ee_pose, target_pose, rngs), "told": np.zeros(len(rngs))}

    def replan(self, state, ee_pose, target_pose, solids):
        return {**state, "told": np.count_nonzero(solids.size[:, :, 3], axis=1).astype(float)}


def test_motions_avoid_the_solids_of_their_row_now_and_at_later_subgoals(robot):
    wary = SubgoalMotion(Wary())
    sequence = begin(robot, 3, [SubgoalMotion(Linear()), wary, wary])
    told = lambda: sequence.snapshot()["motion.1.told"].tolist()  # noqa: E731
    solids = Solids.empty(3, 4)
    for row in range(3):
        solids.size[row, :row, 3] = 1.0
    sequence.avoid(solids)
    at_once = np.ones(3, dtype=bool)
    sequence.end_subgoals(at_once, FAR)
    assert told() == [0.0, 1.0, 2.0]
    solids.size[:, :, 3] = 1.0
    sequence.avoid(solids, np.array([1]))
    assert told() == [0.0, 4.0, 2.0]
    sequence.end_subgoals(np.array([True, False, False]), FAR)
    assert told() == [4.0, 4.0, 2.0]
    sequence.start(random_poses(1), random_poses(3, 1)[np.newaxis], rngs([0]))  # without solids
    sequence.end_subgoals(at_once[:1], FAR)
    assert told() == [0.0]


def test_poses_ahead_lie_between_the_desired_pose_and_the_goal(robot):
    sequence = begin(robot)
    follow(sequence, 20)
    ahead = sequence.ahead(np.array([0.0, 0.1, 100.0]))
    for pose, expected in ((ahead[:, 0], sequence.desired), (ahead[:, 2], sequence.goal)):
        np.testing.assert_allclose(np.stack(spatial.distance(pose, expected)), 0.0, atol=1e-6)
    tips = begin(robot, subgoals=[SubgoalMotion(Linear(), "tip")])
    apart = spatial.compose(tips.ahead(np.array([0.1])), tool_pose(robot))[:, 0]
    tip = spatial.compose(tips.desired, np.broadcast_to(tool_pose(robot), (6, 7)))
    np.testing.assert_allclose(spatial.distance(apart, tip)[0], 0.1, atol=1e-9)


def test_paused_rows_stay(robot):
    sequence, paused = begin(robot), np.array([True, False] * 3)
    for subgoal in range(4):
        before, moves = sequence.desired, sequence.step_of(HORIZON)
        kept = sequence.snapshot()
        sequence.move(moves, paused)
        expected = np.where(paused[:, None], before, moves.desired)
        np.testing.assert_array_equal(sequence.desired, expected)
        for key, values in sequence.snapshot().items():
            np.testing.assert_array_equal(values[paused], kept[key][paused], err_msg=key)
        sequence.end_subgoals(np.ones(6, dtype=bool), FAR)
        if subgoal == 1:
            follow(sequence, 3)


def test_randomness_differs_between_rows_and_subgoals(robot):
    sequence = MotionSequence(
        [SubgoalMotion(Wander()), SubgoalMotion(Wander())], IkSolver(robot), HORIZON
    )
    sequence.start(random_poses(2), np.tile(spatial.IDENTITY, (2, 2, 1)), rngs(range(2)))
    first = sequence.goal
    sequence.end_subgoals(np.ones(2, dtype=bool), FAR)
    assert len(np.unique(np.concatenate([first, sequence.goal])[:, 0])) == 4


def test_the_rest_of_a_closed_path_is_looked_at_to_its_end_and_resumes_there(robot, tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    rows = [[0.1 * np.cos(a) - 0.1, 0.1 * np.sin(a), 0, 0, 0, 0, 1] for a in angle]
    file = tmp_path / "circle.yaml"
    file.write_text(f"poses: {np.array(rows).tolist()}")
    circle = [SubgoalMotion(Waypoints(file=str(file)))] * 2
    sequence = MotionSequence(circle, IkSolver(robot), HORIZON)
    there = random_poses(2)
    sequence.start(there, np.stack([there, there], axis=1), rngs(range(2)))
    near = np.ones(2, dtype=bool)
    for row, ahead in enumerate(sequence.to_the_end(np.arange(2))):
        assert np.linalg.norm(ahead[:, :3] - there[row, :3], axis=1).max() > 0.19
    assert not sequence.ended(near).any()
    again, ends = MotionSequence(circle, IkSolver(robot), HORIZON), []
    for step in range(200):
        if step == 50:
            again.restore(sequence.snapshot())
        for one in (sequence, again) if step >= 50 else (sequence,):
            one.move(one.step_of(HORIZON))
        ends.append(sequence.ended(near))
        if step >= 50:
            np.testing.assert_array_equal(again.ended(near), ends[-1])
    assert not ends[40].any()
    assert ends[-1].all()
    assert not sequence.ended(~near).any()
