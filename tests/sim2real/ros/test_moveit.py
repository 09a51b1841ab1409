"""Services of ROS 2, called as a node with `rmw_cyclonedds_cpp` does."""

import struct

import numpy as np
import pytest
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from kinfeas.api.reach import reach
from kinfeas.api.serve import PlanningServer
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.ros.moveit import MOVEIT
from tests.builders import TIMEOUT, wait

CLIENT, TYPES = 0xFEDCBA9876543210, "moveit_msgs::srv::dds_::"
DEFAULTS = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


class Client:
    def __init__(self, participant, service, kind):
        request, reply = (getattr(MOVEIT, f"{kind}_{part}") for part in ("Request", "Response"))
        topics = Topic(participant, f"rq{service}Request", request)
        self.writer = DataWriter(participant, topics, qos=DEFAULTS)
        replies = Topic(participant, f"rr{service}Reply", reply)
        self.reader, self.number = DataReader(participant, replies, qos=DEFAULTS), 0
        wait(self.writer.get_matched_subscriptions)
        wait(self.reader.get_matched_publications)

    def __call__(self, request):
        self.number += 1
        request.client, request.request_number = CLIENT, self.number
        self.writer.write(request)
        reply = next(self.reader.take_iter(timeout=duration(seconds=TIMEOUT)))
        assert (reply.client, reply.request_number) == (CLIENT, self.number)
        return reply


@pytest.fixture(scope="module")
def participant(domain):
    """A participant beside a server of HSR in a room."""
    with PlanningServer("hsr", "room", 0, ros2=True):
        yield DomainParticipant(domain)


@pytest.fixture(scope="module")
def compute_ik(participant):
    return Client(participant, "/kinfeas/compute_ik", "GetPositionIK")


@pytest.fixture(scope="module")
def compute_path(participant):
    return Client(participant, "/kinfeas/compute_cartesian_path", "GetCartesianPath")


def ik(x=1.0, z=0.8, frame="map", **fields):
    goal = MOVEIT.PoseStamped(MOVEIT.Header(frame_id=frame), pose(x, z))
    return MOVEIT.GetPositionIK_Request(
        ik_request=MOVEIT.PositionIKRequest(pose_stamped=goal, **fields)
    )


def pose(x, z=0.8):
    return MOVEIT.Pose(MOVEIT.Point(x, 0.5, z))


def path(*xs, **fields):
    return MOVEIT.GetCartesianPath_Request(
        waypoints=[pose(x) for x in xs], **{"max_step": 0.01, **fields}
    )


def base_of(state):
    (base,), frame = state.transforms, state.header.frame_id
    assert (frame, state.joint_names) == ("map", ["world_joint"])
    p, q = base.translation, base.rotation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def test_base_poses_are_those_of_reach(compute_ik):
    reply = compute_ik(ik())
    (placement,) = reach("hsr", [[1.0, 0.5, 0.8, 0, 0, 0, 1]], scene="room", k=1)
    assert reply.error_code.val == 1
    base, joints = reply.solution.multi_dof_joint_state, reply.solution.joint_state
    np.testing.assert_allclose(base_of(base), placement.base_pose[0])
    np.testing.assert_allclose(joints.position, placement.joint_positions[0])
    assert joints.name[0] == "arm_lift_joint"
    several = MOVEIT.GetPositionIK_Request()
    several.ik_request.pose_stamped_vector = [ik().ik_request.pose_stamped]
    assert compute_ik(several).solution == reply.solution


def test_plans_lead_along_straight_lines_from_the_start_state(compute_path):
    reply = compute_path(path(1.0, 1.1, 1.2))
    assert (reply.error_code.val, reply.fraction) == (1, 1.0)
    arm, base = reply.solution.joint_trajectory, reply.solution.multi_dof_joint_trajectory
    assert len(arm.points) == len(base.points) == 21
    assert base.points[-1].time_from_start.to_sec() >= 2.0 - 1e-6
    assert arm.points[0].positions == reply.start_state.joint_state.position
    again = compute_path(path(1.2, start_state=reply.start_state))
    assert again.error_code.val == 1
    assert len(again.solution.joint_trajectory.points) in {21, 22}  # the EE is not exactly there
    begun, onward = (base_of(each.start_state.multi_dof_joint_state) for each in (reply, again))
    assert onward == pytest.approx(begun, abs=1e-6)


FIXED_LIFT = MOVEIT.Constraints(joint_constraints=[MOVEIT.JointConstraint("arm_lift_joint")])
FAR = MOVEIT.MultiDOFJointState(transforms=[MOVEIT.Transform(MOVEIT.Vector3(2e4))])


@pytest.mark.parametrize(("fields", "code"), [
    ({"z": 3.0}, -31), ({"frame": "odom"}, -21), ({"x": np.nan}, -16),
    ({"constraints": FIXED_LIFT}, -16), ({"ik_link_name": "base_link"}, -18),
    ({"robot_state": MOVEIT.RobotState(multi_dof_joint_state=FAR)}, -17),
])  # fmt: skip
def test_requests_without_base_pose_have_error_codes(compute_ik, fields, code):
    error = compute_ik(ik(**fields)).error_code
    assert (error.val, error.source) == (code, "kinfeas")
    assert error.message


ARM = [joint.name for joint in load_robot("hsr").arm]
LIFTED = MOVEIT.JointState(name=ARM, position=[5.0, *[0.0] * (len(ARM) - 1)])


@pytest.mark.parametrize(("xs", "fields", "code"), [
    ([], {}, -16), ([1.0], {}, -16), ([1.0, np.nan], {}, -16),
    ([1.0, 1.1], {"max_step": 1e-9}, -16), ([1.0] * 10_001, {}, -16),
    ([1.0, 9.0], {"max_step": 1.0}, -1),
    ([1.0, 1.1], {"header": MOVEIT.Header(frame_id="base_footprint")}, -21),
    ([1.0, 1.1], {"start_state": MOVEIT.RobotState(MOVEIT.JointState(name=["a"]))}, -17),
    ([1.0, 1.1], {"start_state": MOVEIT.RobotState(LIFTED)}, -17),
])  # fmt: skip
def test_requests_without_plan_have_error_codes(compute_path, xs, fields, code):
    reply = compute_path(path(*xs, **fields))
    assert (reply.error_code.val, reply.fraction) == (code, 0.0)
    assert reply.error_code.message


def test_topics_and_types_have_the_names_of_ros(participant, compute_ik, compute_path):
    names = {}
    for kind in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription):
        reader = BuiltinDataReader(participant, kind)
        names |= {topic.topic_name: topic.type_name for topic in reader.take(100)}
    assert (
        names.items()
        >= {
            "rq/kinfeas/compute_ikRequest": f"{TYPES}GetPositionIK_Request_",
            "rr/kinfeas/compute_ikReply": f"{TYPES}GetPositionIK_Response_",
            "rq/kinfeas/compute_cartesian_pathRequest": f"{TYPES}GetCartesianPath_Request_",
            "rr/kinfeas/compute_cartesian_pathReply": f"{TYPES}GetCartesianPath_Response_",
        }.items()
    )


def _cdr(*values):
    """Return values in CDR: integers of 4 bytes, strings, flags, floats and the client's header."""
    data = b""
    for value in values:
        kind = {int: "i", str: "I", bool: "?", float: "d", tuple: "Qq"}[type(value)]
        data += bytes(-len(data) % struct.calcsize(kind[0]))
        if isinstance(value, str):
            data += struct.pack("<I", len(value) + 1) + value.encode() + b"\0"
        else:
            data += struct.pack(f"<{kind}", *value if isinstance(value, tuple) else [value])
    return b"\0\1\0\0" + data


def test_requests_on_the_wire_have_the_header_of_rmw_cyclonedds():
    joints, bases = (0, 0, "", 0, 0, 0, 0), (0, 0, "", 0, 0, 0, 0)
    state, constraints, none = (*joints, *bases, 0, False), ("", 0, 0, 0, 0), (0, 0)
    goal = (0, 0, "map", 1.0, 0.5, 0.8, 0.0, 0.0, 0.0, 1.0)
    data = _cdr((CLIENT, 7), "", *state, *constraints, False, "", *goal, *none, 0, 0)
    request = ik()
    request.client, request.request_number = CLIENT, 7
    assert request.serialize(use_version_2=False) == data
    header, waypoints = (0, 0, "map"), (1, 1.0, 0.5, 0.8, 0.0, 0.0, 0.0, 1.0)
    steps = (0.01, 0.0, 0.0, 0.0, False)
    data = _cdr((CLIENT, 8), *header, *state, "arm", "", *waypoints, *steps, *constraints)
    newer = data + bytes(-len(data) % 4) + bytes(32)  # fields that Humble's type lacks
    for read in map(MOVEIT.GetCartesianPath_Request.deserialize, (data, newer)):
        assert (read.client, read.request_number, read.group_name) == (CLIENT, 8, "arm")
        assert (read.waypoints, read.max_step) == ([pose(1.0)], 0.01)
