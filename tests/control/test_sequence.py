import numpy as np
import pytest

from kinfeas.control.execution import ExecutionConfig, SubgoalMotion, tool_pose
from kinfeas.control.observation import HORIZON
from kinfeas.control.sequence import MotionSequence
from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.plugins.linear import Linear
from tests.builders import assert_near, random_poses, rngs

FAR = np.zeros(1, dtype=bool)  # no EE is as near as a grip needs it


class Counting:
    """Shows bases at as many metres as it has counted steps; its goal is as high as its solids."""

    def start(self, ee_pose, target_pose, rngs):
        return {"goal": target_pose.copy(), "count": np.zeros(len(target_pose))}

    def goal_pose(self, state, target_pose):
        return state["goal"].copy()

    def twist(self, state, ee_pose, target_pose, dt):
        twist = spatial.twist_between(ee_pose, state["goal"], 2.0)
        return twist, {**state, "count": state["count"] + 1.0}

    def base_pose(self, state, target_pose):
        pose = np.tile(spatial.IDENTITY, (len(state["count"]), 1))
        pose[:, 0] = state["count"]
        return pose

    def replan(self, state, ee_pose, target_pose, solids):
        goal = state["goal"].copy()
        goal[:, 2] = np.count_nonzero(solids.size[:, :, 3], axis=1)
        return {**state, "goal": goal}


class Lingering(Linear):
    """Ends 900 steps later in each row than in the one before."""

    def start(self, ee_pose, target_pose, rngs):
        return {"left": 900.0 * np.arange(1.0, len(rngs) + 1.0)}

    def twist(self, state, ee_pose, target_pose, dt):
        twist, _ = super().twist(state, ee_pose, target_pose, dt)
        return twist, {"left": state["left"] - 1.0}

    def finished(self, state, target_pose):
        return state["left"] <= 0.0


LINEAR = Linear()


@pytest.fixture
def begin(solver):
    """A function that returns a sequence of n EEs at random poses with random targets."""

    def build(n, subgoals, **execution):
        sequence = MotionSequence(subgoals, solver, HORIZON, ExecutionConfig(**execution))
        targets = random_poses((n, len(subgoals)), 1)
        sequence.start(random_poses(n), targets, rngs(n))
        return sequence

    return build


def test_the_base_is_demonstrated_on_its_subgoals_only(begin):
    sequence = begin(3, [SubgoalMotion(Counting()), SubgoalMotion(LINEAR)])
    for _ in range(5):
        sequence.move(sequence.step_of(HORIZON))
        sequence.end_subgoals(np.array([False, True, False]), FAR)
    base = sequence.demonstrated_base
    np.testing.assert_array_equal(base[[0, 2], 0], 5.0)
    assert np.isnan(base[1]).all()


@pytest.mark.parametrize(("settled_at", "stops_at"), [(2, 2), (0, 0), (99, 4)])
def test_a_subgoal_that_ends_with_a_grip_goes_on_until_it_settles(begin, settled_at, stops_at):
    subgoals = [SubgoalMotion(LINEAR, dwell=0.3, grip=grip) for grip in ("close", "open")]
    sequence = begin(1, subgoals, time_scale=0.5, grasp_settle_time=0.2)
    stops, moves = [], []
    for i in range(7):
        before = sequence.desired
        sequence.move(sequence.step_of(HORIZON))
        moves.append(bool(np.any(sequence.desired != before)))
        stops += sequence.end_subgoals(np.ones(1, dtype=bool), np.array([i >= settled_at])).tolist()
    assert stops == [i == stops_at for i in range(7)]
    assert moves[: stops_at + 4] == ([True] * (stops_at + 1) + [False] * 3)[: len(moves)]


def test_motions_avoid_the_solids_of_their_row_now_and_at_later_subgoals(begin):
    wary = SubgoalMotion(Counting())
    sequence, solids = begin(3, [SubgoalMotion(LINEAR), wary, wary]), Solids.empty(3, 4)
    for row in range(3):
        solids.size[row, :row, 3] = 1.0
    sequence.avoid(solids)
    at_once = np.ones(3, dtype=bool)
    sequence.end_subgoals(at_once, FAR)
    np.testing.assert_allclose(sequence.goal[:, 2], [0.0, 1.0, 2.0], atol=1e-9)
    solids.size[:, :, 3] = 1.0
    sequence.avoid(solids, np.array([1]))
    np.testing.assert_allclose(sequence.goal[:, 2], [0.0, 4.0, 2.0], atol=1e-9)
    sequence.end_subgoals(np.array([True, False, False]), FAR)
    np.testing.assert_allclose(sequence.goal[:, 2], [4.0, 4.0, 2.0], atol=1e-9)
    target = random_poses((1, 3), 1)
    sequence.start(random_poses(1), target, rngs(1))  # without solids
    sequence.end_subgoals(at_once[:1], FAR)
    np.testing.assert_allclose(sequence.goal, target[:, 1], atol=1e-9)


def test_poses_ahead_lie_between_the_desired_pose_and_the_goal(robot, begin):
    sequence = begin(6, [SubgoalMotion(LINEAR, "tip")])
    sequence.move(sequence.step_of(HORIZON))
    ahead = sequence.ahead(np.array([0.0, 0.1, 100.0]))
    assert_near(ahead[:, 0], sequence.desired, 1e-6, 1e-6)
    assert_near(ahead[:, 2], sequence.goal, 1e-6, 1e-6)
    tool = np.broadcast_to(tool_pose(robot), (6, 7))
    tips = [spatial.compose(pose, tool) for pose in (ahead[:, 1], sequence.desired)]
    np.testing.assert_allclose(spatial.distance(*tips)[0], 0.1, atol=1e-9)


def test_motions_end_in_some_rows_as_in_all(begin):
    sequence = begin(3, [SubgoalMotion(Lingering())])
    every = sequence.to_the_end(np.arange(3))
    assert [len(poses) for poses in every] == [901, 1801, 2701]
    np.testing.assert_array_equal(sequence.to_the_end(np.array([1]))[0], every[1])
    (to_rest,) = sequence.to_the_end(np.array([0]), to_rest=True)
    assert len(to_rest) == 911
