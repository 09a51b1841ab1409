import numpy as np
import pytest

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, distance, planar_pose
from kinfeas.core.start import episode_rng
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.kinematics.solids import collides
from kinfeas.planning.base_goal import CHECKED_AHEAD, BaseGoalPlanner, BaseGoalSettings
from kinfeas.planning.base_lattice import LATTICE, lattice_moves
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import joint_displacement
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import sample_start

EPISODES = 12


def goal_of(start):
    """Return x and y of the goal."""
    return start.target_poses[0, :2]


@pytest.fixture(scope="module", params=["tiago", "hsr"])
def planned(request):
    """Planner, starts among solids, and the path of each."""
    solver = IkSolver(load_robot(request.param))
    planner = BaseGoalPlanner(solver)
    starts = starts_of(planner, "ggr_obstacles")
    return planner, starts, [plan(planner, start) for start in starts]


def starts_of(planner, task):
    task = load_task(task)
    return [sample_start(task, planner.solver, episode_rng(1, k)) for k in range(EPISODES)]


def plan(planner, start, solids=None):
    state = start.base_pose, start.joint_positions, start.target_poses[0]
    return planner.plan(*state, solids or start.solids)


def test_paths_lead_from_the_start_to_the_goal_within_the_limits(planned):
    planner, starts, paths = planned
    robot, chain = planner.robot, planner.solver.chain
    assert sum(path is not None for path in paths) >= 0.8 * EPISODES
    for start, path in zip(starts, paths, strict=True):
        if path is None:
            continue
        ee = compose(start.base_pose, forward(chain, start.joint_positions))
        assert np.max(distance(path.ee[0], ee)) < 1e-6
        assert np.max(distance(path.ee[-1], start.target_poses[0])) < 1e-9
        base, arm = planar_pose(*path.robot[:, :3].T), path.robot[:, 3:]
        assert np.max(distance(path.ee[:-1], compose(base, forward(chain, arm))[:-1])) < 1e-9
        step = np.diff(path.robot, axis=0)
        speed = np.linalg.norm(step[:, :2], axis=1) / path.seconds
        assert speed.max() <= robot.base.max_velocity
        assert np.max(np.abs(step[:, 2]) / path.seconds) <= robot.base.max_rotation
        joints = np.abs(joint_displacement(robot, arm[:-1], arm[1:]))
        assert np.all(joints <= robot.max_joint_velocity * path.seconds[:, np.newaxis] + 1e-9)
        assert np.max(distance(path.ee[:-1], path.ee[1:])) < 0.5


@pytest.mark.parametrize(
    ("task", "time_scale"), [("ggr_obstacles", 1.0), ("ggr_dynamic", 1.0), ("ggr_dynamic", 0.5)]
)
def test_base_and_arm_follow_the_paths_without_collisions(planned, task, time_scale):
    planner, starts, paths = planned
    if task == "ggr_dynamic":
        planner = BaseGoalPlanner(planner.solver, time_scale)
        starts = starts_of(planner, task)
        paths = [plan(planner, start) for start in starts]
    shapes, free = planner.solver.collision, []
    for start, path in zip(starts, paths, strict=True):
        if path is not None:
            seconds = np.concatenate([[0.0], np.cumsum(path.seconds / time_scale)])
            seconds = np.minimum(seconds, LATTICE.foresight)
            among = start.solids.of(np.zeros(len(path.ee), dtype=np.intp)).at(seconds)
            base, arm = planar_pose(*path.robot[:, :3].T), np.ascontiguousarray(path.robot[:, 3:])
            touching = collides(shapes, arm, base, among).any(axis=1)
            free.append(not np.any(touching | self_collides(shapes, arm)))
    assert np.mean(free) >= 0.8


def test_plans_are_deterministic_and_walls_have_none(planned):
    planner, starts, paths = planned
    for start, path in zip(starts[:3], paths, strict=False):
        again = plan(planner, start)
        if path is not None:
            np.testing.assert_array_equal(path.ee, again.ee)
    walls, far = Solids.empty(1, 4), [one for one in starts if np.hypot(*goal_of(one)) > 4.0]
    x, y = goal_of(far[0])
    walls.pose[0] = [[x + 2, y, 0], [x - 2, y, 0], [x, y + 2, 0], [x, y - 2, 0]]
    walls.size[0] = [[0.1, 2.2, 0, 2], [0.1, 2.2, 0, 2], [2.2, 0.1, 0, 2], [2.2, 0.1, 0, 2]]
    assert plan(planner, far[0], walls) is None
    walls.size[0, 0] = 0.0
    assert plan(planner, far[0], walls) is not None


def test_a_way_is_free_until_something_moves_into_it(planned):
    planner, starts, _ = planned
    arm = np.tile(starts[0].joint_positions, (len(CHECKED_AHEAD), 1))
    robot = np.column_stack([0.1 * CHECKED_AHEAD, np.zeros((len(CHECKED_AHEAD), 2)), arm])
    solids = Solids.empty(1, 1)
    solids.pose[0, 0, :2], solids.size[0, 0] = [0.3, -1.5], [0.1, 0.1, 0.0, 0.3]
    assert planner.free(robot, solids)
    solids.velocity[0, 0, 1] = 0.4
    assert not planner.free(robot, solids)
    assert not planner.free(np.full_like(robot, np.nan), solids)


@pytest.mark.parametrize("omnidirectional", [True, False])
def test_moves_of_differential_bases_are_along_their_heading(omnidirectional):
    moves = lattice_moves(omnidirectional=omnidirectional)
    assert len(moves) == LATTICE.headings
    x, y, _, cost = np.moveaxis(moves, -1, 0)
    assert np.all(cost >= 1000 * LATTICE.cell * np.hypot(x, y) - 1)
    heading = 2.0 * np.pi / LATTICE.headings * np.arange(LATTICE.headings)[:, np.newaxis]
    aside = np.abs(np.cos(heading) * y - np.sin(heading) * x) / np.maximum(np.hypot(x, y), 1)
    assert (aside.max() > 0.9) == omnidirectional
    assert omnidirectional or aside.max() < 0.1


def test_a_robot_whose_ee_never_is_ahead_plans_too():
    solver, task = IkSolver(load_robot("hsr")), load_task("ggr_obstacles")
    planner = BaseGoalPlanner(solver, settings=BaseGoalSettings(rest_reach=(50.0, 60.0)))
    starts = [sample_start(task, solver, episode_rng(1, k)) for k in range(3)]
    assert any(plan(planner, start) is not None for start in starts)
