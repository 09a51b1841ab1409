"""Services of MoveIt 2 for base poses and plans, so that its clients need no other packages.

Types are those of `moveit_msgs`, branch `ros2`. Requests of its versions 2.2 (Humble) to 2.6 differ
in their last fields, which are not read. Clients of 2.2 do not read the last fields of replies.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from kinfeas.core.checks import ee_poses
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import Array, compose, distance, interpolated, planar_pose
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.reach import Placement
from kinfeas.planning.whole_body import Moments
from kinfeas.sim2real.ros.messages import planar, pose_of
from kinfeas.sim2real.ros.ros2 import MESSAGES, Ros2Bus, message_classes
from kinfeas.sim2real.ros.topics import BaseTopics, read_topics

_log = logging.getLogger(__name__)

SERVICES = {
    "GetPositionIK": "/kinfeas/compute_ik",
    "GetCartesianPath": "/kinfeas/compute_cartesian_path",
}
"""Names of services by type."""

SUCCESS, FAILURE, PLANNING_FAILED, INVALID_GOAL_CONSTRAINTS = 1, 99999, -1, -16
INVALID_ROBOT_STATE, INVALID_LINK_NAME, FRAME_TRANSFORM_FAILURE, NO_IK_SOLUTION = -17, -18, -21, -31

_BASE_JOINT = "world_joint"
_MOST_WAYPOINTS = 10_000
_EE_VELOCITY = 0.1  # m/s, slower where base or arm need time
_STEPS = (1e-4, 1.0)  # least and largest `max_step`, metres
_TURN = 3.5  # radians that count as a metre of `max_step`, as in MoveIt


class MoveItServices:
    """Answers `moveit_msgs/srv/GetPositionIK` and `GetCartesianPath` for one robot."""

    def __init__(
        self,
        solver: IkSolver,
        reach: Callable[..., Sequence[Placement]],
        plan: Callable[..., Moments],
    ) -> None:
        """Join the domain of `ROS_DOMAIN_ID` and answer from a thread, for the robot of a solver.

        `reach` and `plan` are those of `kinfeas` for this robot. Raises KinfeasError if there is no
        such domain, or the robot's `ros2.yaml` is invalid.
        """
        robot = solver.robot
        has_topics = (robot.folder / "ros2.yaml").is_file()
        topics = read_topics(robot, 2) if has_topics else None
        names = topics.joints.names if topics else {}
        self._frame = topics.base.world_frame if topics else BaseTopics.world_frame
        self._joints = [names.get(joint.name, joint.name) for joint in robot.arm]
        self._solver, self._reach, self._plan = solver, reach, plan
        self._bus = Ros2Bus()
        self._bus.open("kinfeas")
        for kind, answer in (
            ("GetPositionIK", self._base_pose),
            ("GetCartesianPath", self._motion),
        ):
            classes = tuple(getattr(MOVEIT, f"{kind}_{part}") for part in ("Request", "Response"))
            self._bus.serve(SERVICES[kind], classes, _replying(classes[1], answer))

    def close(self) -> None:
        """Leave the domain."""
        self._bus.close()

    def _base_pose(self, request: Any, reply: Any) -> None:
        ik = request.ik_request
        self._check(ik.robot_state, ik.constraints, [ik.ik_link_name, *ik.ik_link_names])
        goals = ik.pose_stamped_vector or [ik.pose_stamped]
        with _failing(INVALID_GOAL_CONSTRAINTS):
            if len(goals) != 1:
                raise KinfeasError("'pose_stamped_vector' must have one pose")
            pose = ee_poses([_numbers(goals[0].pose)], "pose_stamped")
        self._check_frame(goals[0].header)
        start = self._start(ik.robot_state)
        with _failing(INVALID_ROBOT_STATE):
            (placement,) = self._reach(poses=pose, start=start, k=1)
        if not placement.reachable:
            raise _RequestError(NO_IK_SOLUTION, placement.reason)
        self._fill_state(reply.solution, placement.base_pose[0], placement.joint_positions[0])

    def _motion(self, request: Any, reply: Any) -> None:
        self._check(request.start_state, request.path_constraints, [request.link_name])
        self._check_frame(request.header)
        if not 1 <= len(request.waypoints) <= _MOST_WAYPOINTS:
            text = f"'waypoints' must have 1 to {_MOST_WAYPOINTS} poses"
            raise _RequestError(INVALID_GOAL_CONSTRAINTS, text)
        with _failing(INVALID_GOAL_CONSTRAINTS):
            waypoints = ee_poses([_numbers(pose) for pose in request.waypoints], "waypoints")
        start, joints = self._start(request.start_state), self._arm(request.start_state)
        if joints is not None and start is None:
            raise _RequestError(INVALID_ROBOT_STATE, "an arm needs a base pose")
        if start is not None:
            waypoints = np.vstack([self._ee(start, joints), waypoints])
        with _failing(INVALID_GOAL_CONSTRAINTS):
            path = _dense(waypoints, request.max_step)
        step = request.max_step / _EE_VELOCITY
        with _failing(PLANNING_FAILED):
            plan = self._plan(path=path, step=step, start=start, joints=joints)
        self._fill_trajectory(reply.solution, plan)
        self._fill_state(reply.start_state, plan.base_pose[0], plan.joint_positions[0])
        reply.fraction = 1.0

    def _check(self, state: Any, constraints: Any, links: Sequence[str]) -> None:
        kinds = ("joint", "position", "orientation", "visibility")
        if any(getattr(constraints, f"{kind}_constraints") for kind in kinds):
            raise _RequestError(INVALID_GOAL_CONSTRAINTS, "constraints are not supported")
        if state.attached_collision_objects:
            raise _RequestError(INVALID_ROBOT_STATE, "attached objects are not supported")
        ee = self._solver.robot.ee_frame
        if other := set(links) - {"", ee}:
            raise _RequestError(INVALID_LINK_NAME, f"poses are of {ee}, not {min(other)}")

    def _check_frame(self, header: Any) -> None:
        if header.frame_id.lstrip("/") not in ("", self._frame):
            text = f"poses must be in {self._frame}, not {header.frame_id}"
            raise _RequestError(FRAME_TRANSFORM_FAILURE, text)

    def _start(self, state: Any) -> list[float] | None:
        """Return x, y and yaw of the base; None if the state does not have them."""
        transforms = state.multi_dof_joint_state.transforms
        if not transforms:
            return None
        if len(transforms) > 1:
            raise _RequestError(
                INVALID_ROBOT_STATE, "only the base may have several degrees of freedom"
            )
        self._check_frame(state.multi_dof_joint_state.header)
        base = planar(pose_of(transforms[0].translation, transforms[0].rotation))
        if not (np.abs(base) <= FARTHEST).all():
            raise _RequestError(INVALID_ROBOT_STATE, f"the base must be within {FARTHEST:g} m")
        return list(base)

    def _arm(self, state: Any) -> list[float] | None:
        """Return the arm joints; None if the state has none of them."""
        names, positions = state.joint_state.name, state.joint_state.position
        if len(names) != len(positions):
            raise _RequestError(INVALID_ROBOT_STATE, "each joint needs a position")
        by_name = dict(zip(names, positions, strict=True))
        joints = [by_name[name] for name in self._joints if name in by_name]
        if not joints:
            return None
        if len(joints) < len(self._joints):
            raise _RequestError(INVALID_ROBOT_STATE, "each arm joint needs a position")
        lower, upper = self._solver.robot.joint_limits
        if not (np.isfinite(joints) & (joints >= lower) & (joints <= upper)).all():
            raise _RequestError(INVALID_ROBOT_STATE, "arm joints must be within their limits")
        return joints

    def _ee(self, start: Sequence[float], joints: Sequence[float] | None) -> Array:
        arm = self._solver.robot.home["home"] if joints is None else np.array(joints)
        base = planar_pose(*np.array(start)[:, np.newaxis])
        return compose(base, forward(self._solver.chain, arm[np.newaxis]))

    def _fill_state(self, state: Any, base: Array, joints: Array) -> None:
        state.joint_state.name, state.joint_state.position = self._joints, joints.tolist()
        bases = state.multi_dof_joint_state
        bases.header.frame_id, bases.joint_names = self._frame, [_BASE_JOINT]
        bases.transforms = [_transform(base)]

    def _fill_trajectory(self, trajectory: Any, plan: Moments) -> None:
        arm, base = trajectory.joint_trajectory, trajectory.multi_dof_joint_trajectory
        base.header.frame_id, base.joint_names = self._frame, [_BASE_JOINT]
        arm.joint_names = self._joints
        moments = zip(
            plan.time.tolist(), plan.base_pose, plan.joint_positions.tolist(), strict=True
        )
        for seconds, pose, joints in moments:
            stamp = MOVEIT.Duration.from_sec(seconds)
            arm.points.append(MOVEIT.JointTrajectoryPoint(joints, time_from_start=stamp))
            point = MOVEIT.MultiDOFJointTrajectoryPoint([_transform(pose)], time_from_start=stamp)
            base.points.append(point)


class _RequestError(Exception):
    """A request without a solution, with its code of `MoveItErrorCodes`."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@contextmanager
def _failing(code: int) -> Iterator[None]:
    try:
        yield
    except KinfeasError as error:
        raise _RequestError(code, str(error)) from error


def _replying(kind: Any, fill: Callable[[Any, Any], None]) -> Callable[[Any], Any]:
    """Return a function from requests to replies of a class, with an error code."""

    def answer(request: Any) -> Any:
        reply = kind()
        reply.error_code.val, reply.error_code.source = SUCCESS, "kinfeas"
        try:
            fill(request, reply)
        except _RequestError as error:
            reply.error_code.val, reply.error_code.message = error.code, str(error)
        except Exception:  # noqa: BLE001 - a client waits for a reply
            _log.exception("a request was not answered")
            reply.error_code.val = FAILURE
        return reply

    return answer


def _dense(waypoints: Array, max_step: float) -> Array:
    """Return poses on straight lines through waypoints, at most `max_step` metres apart."""
    if len(waypoints) < 2:
        raise KinfeasError("'waypoints' must have 2 poses, or one with a start state")
    low, high = _STEPS
    if not low <= max_step <= high:
        raise KinfeasError(f"'max_step' must be {low} to {high} m, not {max_step}")
    metres, radians = distance(waypoints[:-1], waypoints[1:])
    lengths = np.maximum(metres, radians / _TURN) / max_step
    steps = np.ceil(lengths - 1e-6).clip(1.0)  # 10, not 11, of 0.1 m by 0.01 m
    samples = np.concatenate([[0.0], np.cumsum(steps)])
    if samples[-1] >= _MOST_WAYPOINTS:
        raise KinfeasError(f"'max_step' makes more than {_MOST_WAYPOINTS} poses")
    return interpolated(np.arange(samples[-1] + 1.0), samples, waypoints)


def _numbers(pose: Any) -> list[float]:
    return pose_of(pose.position, pose.orientation).tolist()


def _transform(pose: Array) -> Any:
    x, y, z, *rotation = pose.tolist()
    return MOVEIT.Transform(MOVEIT.Vector3(x, y, z), MOVEIT.Quaternion(*rotation))


MOVEIT = message_classes("moveit_messages.txt", vars(MESSAGES))
"""Message classes by name."""
