"""Reactive whole-body IK: one quadratic program over base and arm per step.

The paper does not have this baseline. It looks one step ahead: the motion of the base results from
the next EE pose and a preferred posture of the arm.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.filters.half_spaces import VelocityConstraints
from kinfeas.control.filters.obstacle_distance import VelocityDamper
from kinfeas.control.observation import HORIZON
from kinfeas.core.extras import EXTRAS, require
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import Array, relative
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.forward import Tree, build_chain
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.robots.robot import Robot

_POSITION_COST, _ROTATION_COST = 10.0, 4.0
"""Weights of the distance to the planned EE pose, per metre and radian."""

_POSTURE_COST, _POSTURE_GAIN = 0.3, 0.05
"""Weight of the distance to the middle of a joint's range, and the fraction removed in a step."""

_BASE_COST, _TURN_COST = 0.3, 0.1
"""Weights of base motion, per metre and radian."""

_DAMPING, _SOLVER = 1e-6, "daqp"


@dataclass
class WholeBodyQp:
    """Moves the base as in the best next step of the whole body.

    Pink solves the quadratic program: bring the EE to its planned pose, hold the arm joints near
    the middle of their ranges and move the base little, within position and velocity limits.
    Barriers limit the velocity of the base towards obstacles, as the filter `obstacle_distance`
    does. The arm part of the solution is not used: the loop's IK places the arm, as for every
    policy. Without a solution the base rests, unless a barrier moves it away.

    Attributes:
        robot: Robot model.
        filters: Command filters before the others, see `Policy`.
    """

    robot: Robot
    filters: tuple[str, ...] = ()

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        joints = observation.joint_positions
        targets = relative(observation.planned, observation.base_pose)
        actions = np.zeros((len(joints), command_size(self.robot.base)))
        barriers: list[list[Barriers]] = [[] for _ in joints]
        if observation.obstacles is not None:
            damper = VelocityDamper(self.robot.base, observation.dt)
            constraints = damper.constraints(observation.obstacles, len(joints))
            actions = constraints.hold(actions[:, np.newaxis])[:, 0]
            barriers = [[Barriers(constraints, row)] for row in range(len(joints))]
        for row in range(len(joints)):
            action = self._step(targets[row], joints[row], barriers[row])
            if action is not None:
                actions[row] = action
        return actions

    def __reduce__(self) -> tuple[type["WholeBodyQp"], tuple[Robot, tuple[str, ...]]]:
        """Pickle without the model, which is built on first use."""
        return WholeBodyQp, (self.robot, self.filters)

    @cached_property
    def _step(self) -> Callable[[Array, Array, list["Barriers"]], Array | None]:
        return _make_step(self.robot)


class Barriers:
    """Velocity constraints on a base as a limit of Pink."""

    def __init__(self, constraints: VelocityConstraints, row: int) -> None:
        limited = np.isfinite(constraints.limit[row])
        self.normal, self.limit = constraints.normal[row, limited], constraints.limit[row, limited]
        self.full_velocity = constraints.full

    def compute_qp_inequalities(self, body: Any, dt: float) -> tuple[Array, Array]:
        """Return G, shape (c, v), and h, shape (c,), of G dq <= h."""
        gradient = np.zeros((len(self.limit), body.model.nv))
        size = len(self.full_velocity)
        gradient[:, :size] = self.normal * self.full_velocity / body.model.velocityLimit[:size]
        return gradient, self.limit * dt


def whole_body_qp(robot: Robot) -> WholeBodyQp:
    """Return the baseline that solves whole-body differential IK as a QP."""
    require("pinocchio", "pink", "qpsolvers", _SOLVER)
    return WholeBodyQp(robot)


def planner(robot: Robot) -> FollowEe | WholeBodyQp:
    """Return the baseline that drives along planned paths of base and arm.

    Where no path is found, it acts as `whole_body_qp`, or as `follow_ee` without the extra `qp`.
    """
    filters = ("path_planner", "feasibility")
    if all(map(find_spec, EXTRAS["qp"])):
        return WholeBodyQp(robot, filters)
    return FollowEe(robot.base, filters=filters)


def build_model(robot: Robot) -> Any:
    """Return Pinocchio's model of base and arm with the EE as frame `ee`.

    The base is at the origin of the model. Its two or three joints move it as its drive can:
    forward, to the left unless the drive is differential, and about the vertical axis. Joints that
    follow another one have no limits of their own.
    """
    import pinocchio as pin

    model, chain = pin.Model(), build_chain(robot)
    base, tree = robot.base, chain.tree
    base_joints = [pin.JointModelPX(), pin.JointModelPY()][: command_size(base) - 1]
    base_joints.append(pin.JointModelRZ())
    speeds = [*[base.max_velocity] * (len(base_joints) - 1), base.max_rotation]
    parent = 0
    for i, (kind, speed) in enumerate(zip(base_joints, speeds, strict=True)):
        bounds = _bounds(speed, -np.inf, np.inf)
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), f"base_{i}", *bounds)
    first = _first(tree)
    for i, variable in enumerate(tree.variable):
        kind = pin.JointModelPZ() if tree.prismatic[i] else pin.JointModelRZ()
        pose = pin.SE3(tree.rotation[i], tree.offset[i])
        bounds = _bounds(np.inf, -np.inf, np.inf)
        if first[i] == i:
            joint, scale = robot.arm[variable], tree.multiplier[i]
            ends = sorted(scale * end + tree.bias[i] for end in (joint.lower, joint.upper))
            bounds = _bounds(abs(scale) * joint.velocity, *ends)
        parent = model.addJoint(parent, kind, pose, f"arm_{i}", *bounds)
    end = pin.SE3(chain.ee_rotation, chain.ee_offset)
    model.addFrame(pin.Frame("ee", parent, 0, end, pin.FrameType.OP_FRAME))
    return model


def _first(tree: Tree) -> NDArray[np.intp]:
    """Return for each joint the index of the first joint with the same variable, shape (m,)."""
    return np.array([tree.variable.tolist().index(v) for v in tree.variable], dtype=np.intp)


def _coupling(tree: Tree, base_size: int) -> Array:
    """Return a matrix whose product with velocities of base and joints is 0, (followers, v)."""
    first = _first(tree)
    followers = np.flatnonzero(first != np.arange(len(first)))
    matrix = np.eye(base_size + len(first))[base_size + followers]
    ratios = tree.multiplier[followers] / tree.multiplier[first[followers]]
    matrix[np.arange(len(followers)), base_size + first[followers]] = -ratios
    return matrix


def _bounds(velocity: float, lower: float, upper: float) -> list[Array]:
    """Return effort, velocity and position limits of a joint as Pinocchio takes them."""
    return [np.array([limit]) for limit in (np.inf, velocity, lower, upper)]


def _make_step(robot: Robot) -> Callable[[Array, Array, list[Barriers]], Array | None]:
    """Return a function that computes the action, or None if the program has no solution.

    Its arguments are the planned EE pose in the base frame, arm joints and barriers.
    """
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.exceptions import NoSolutionFound
    from pink.limits import ConfigurationLimit, VelocityLimit
    from pink.tasks import FrameTask, LinearHolonomicTask, PostureTask

    model, tree = build_model(robot), build_chain(robot).tree
    data, base_size = model.createData(), command_size(robot.base)
    lower, upper, speeds = model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit
    bounded = np.flatnonzero(np.isfinite(upper))
    middle = (lower[bounded] + upper[bounded]) / 2.0
    coupling, start = _coupling(tree, base_size), np.concatenate([np.zeros(base_size), tree.bias])
    coupled = LinearHolonomicTask(coupling, np.zeros(len(coupling)), start)
    constraints = [coupled] if len(coupling) else None
    ee = FrameTask("ee", _POSITION_COST, _ROTATION_COST)
    costs = np.zeros(len(upper))
    costs[bounded] = _POSTURE_COST / (upper[bounded] - lower[bounded])
    costs[: base_size - 1], costs[base_size - 1] = _BASE_COST, _TURN_COST
    posture = PostureTask(costs, gain=_POSTURE_GAIN)
    limits = (ConfigurationLimit(model), VelocityLimit(model))
    rest, q = np.zeros(model.nq), np.zeros(model.nq)

    def step(target: Array, joints: Array, barriers: list[Barriers]) -> Array | None:
        q[base_size:] = tree.multiplier * joints[tree.variable] + tree.bias
        np.clip(q, lower, upper, out=q)
        rest[:] = q
        rest[bounded] = middle
        posture.set_target(rest)
        ee.set_target(pin.XYZQUATToSE3(target))
        body = Configuration(model, data, q, copy_data=False)
        try:
            rules = (*limits, *barriers)
            velocity = solve_ik(
                body, (ee, posture), HORIZON, _SOLVER, _DAMPING, rules,
                constraints=constraints, safety_break=False,
            )  # fmt: skip
        except NoSolutionFound:
            return None
        return np.clip(velocity[:base_size] / speeds[:base_size], -1.0, 1.0)

    return step
