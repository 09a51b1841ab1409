"""A robot in a room as a MuJoCo specification: bodies, motors, and what collides with what."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import mujoco

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.drives import ArmSetpoints
from kinfeas.backends.physics.robot import (
    PLANAR_JOINTS,
    arm_followers,
    finger_followers,
    physics_urdf,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.robot import Robot
from kinfeas.scenes.objects import SceneObject

OWN = "/robot:"
"""Prefix of the robot's names; no object has a slash in its name."""

SOLID = "/solid"
"""Prefix of the bodies of solids, before their number."""

# Bits of contype and conaffinity: fixed objects do not collide with each other, nor the base with
# the floor, nor the robot with itself.
_GROUND, _FIXED, _LOOSE = 1, 2, 4
_FRICTION = (0.5, 0.005, 0.0001)  # sliding (-), torsional and rolling (m)
_PAD_DIMENSIONS = 4  # condim of the fingers' contacts, which also resist twisting
_IMPRATIO = 10.0  # impedance of friction relative to normal forces: objects creep less in the hand
_COUPLING = (0.01, 1.0)  # time constant (s) and damping ratio of mimicking joints
# Time constant (s), damping ratio and impedance of a grasp: some thousand N/m, as fingers have.
_GRASP = (0.02, 1.0, 0.9, 0.9, 0.001, 0.5, 2.0)
_COMPILER = (
    '<mujoco><compiler strippath="false" fusestatic="false" balanceinertia="true" '
    'boundmass="1e-4" boundinertia="1e-8"/></mujoco></robot>'
)


class JointServo(NamedTuple):
    """A position motor of a joint: limits of its effort (N m or N) and velocity (per second)."""

    joint: str
    effort: float
    velocity: float


class RobotBodies(NamedTuple):
    """URDF of a robot for MuJoCo, and names of the bodies on its arm and of each finger."""

    urdf: str
    carried: set[str]
    fingers: list[set[str]]


def servos_of(robot: Robot, arm: ArmSetpoints) -> list[JointServo]:
    """Return the motors of the arm, and of the fingers; mimicking joints have none."""
    limits = zip(arm.names, arm.effort, arm.velocity, strict=True)
    servos = [JointServo(*limit) for limit, _ in zip(limits, robot.arm, strict=False)]
    if robot.gripper is not None:
        for name in robot.gripper.fingers:
            servos.append(JointServo(name, robot.gripper.effort, robot.finger_velocity(name)))
    return servos


def bodies_of(robot: Robot) -> RobotBodies:
    """Return the bodies of a robot; links that do not move against each other are one body."""
    urdf, body_of = physics_urdf(robot)

    def below(joints: Iterable[str]) -> set[str]:
        return {body_of[link] for joint in joints for link in robot.urdf.below(joint)}

    fingers = robot.gripper.fingers if robot.gripper else ()
    carried = below(joint.name for joint in robot.arm)
    return RobotBodies(urdf, carried, [below([finger]) for finger in fingers])


def room_spec(
    robot: Robot,
    bodies: RobotBodies,
    servos: Iterable[JointServo],
    objects: Mapping[str, SceneObject],
    places: int,
    config: PhysicsConfig,
) -> Any:
    """Return a robot in a room with objects, and places for solids."""
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio, spec.option.iterations = _IMPRATIO, config.iterations
    spec.option.gravity = [0.0, 0.0, -config.gravity]
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floor = spec.worldbody.add_geom(type=plane, size=[0.0, 0.0, 1.0], friction=_FRICTION)
    _collide([floor], _GROUND)
    own = _robot_spec(robot, bodies.urdf, servos)
    for body in own.bodies[1:]:
        ground = _GROUND if body.name in bodies.carried else 0
        _collide(body.geoms, 0, _FIXED | _LOOSE | ground)
        pad = any(body.name in links for links in bodies.fingers)
        for geom in body.geoms:
            geom.friction = _FRICTION
            if pad:
                geom.condim = _PAD_DIMENSIONS
                geom.friction = [config.finger_friction, *_FRICTION[1:]]
    spec.attach(own, prefix=OWN, frame=spec.worldbody.add_frame())
    for name, item in objects.items():
        spec.attach(_object_spec(item), prefix=f"{name}:", frame=spec.worldbody.add_frame())
    for place in range(places):
        # Each simulation sets its shape and pose.
        body = spec.worldbody.add_body(name=f"{SOLID}{place}", mocap=True)
        box = mujoco.mjtGeom.mjGEOM_BOX
        _collide([body.add_geom(type=box, size=[0.1] * 3, friction=_FRICTION)], _FIXED)
    return spec


def add_grasp(spec: Any, robot: Robot, name: str, link: str, *, rigid: bool) -> None:
    """Add a soft constraint between hand and an object's link, which a grasp activates."""
    kind = mujoco.mjtEq.mjEQ_WELD if rigid else mujoco.mjtEq.mjEQ_CONNECT
    spec.add_equality(
        name="grasp", type=kind, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False,
        name1=OWN + robot.ee_frame, name2=f"{name}:{link}", solref=_GRASP[:2],
        solimp=_GRASP[2:],
    )  # fmt: skip


def _robot_spec(robot: Robot, urdf: str, servos: Iterable[JointServo]) -> Any:
    """Return the robot with actuators, couplings of mimicking joints, and a sensor of contacts."""
    spec = _read(urdf, str(robot.urdf_path))
    for body in spec.bodies:
        body.gravcomp = 1.0
    for joint in spec.joints:
        joint.frictionloss = 0.0  # of the gears, which the motors overcome
        if joint.name in PLANAR_JOINTS:
            joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        # Carrying the weight is part of a motor's effort, unless springs carry it.
        joint.actgravcomp = joint.name not in robot.counterbalanced
    for mimic in (*arm_followers(robot), *finger_followers(robot)):
        coupling = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=mimic.name, name2=mimic.leader, solref=_COUPLING
        )
        coupling.data[:2] = mimic.offset, mimic.multiplier
    transmissions = dict.fromkeys(PLANAR_JOINTS, mujoco.mjtTrn.mjTRN_JOINT)
    transmissions |= {servo.joint: mujoco.mjtTrn.mjTRN_JOINT for servo in servos}
    if robot.gripper is not None:
        # Both fingers open equally far, up to a force: they also close round an object off centre.
        tendon = spec.add_tendon(name="fingers")
        for finger, factor in zip(
            robot.gripper.fingers, (1.0, -1.0 / robot.gripper.ratio), strict=True
        ):
            tendon.wrap_joint(finger, factor)
        transmissions["fingers"] = mujoco.mjtTrn.mjTRN_TENDON
    for name, transmission in transmissions.items():
        spec.add_actuator(
            name=name, target=name, trntype=transmission,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
    touch = spec.add_sensor(
        name="touch", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=robot.urdf.root,
    )  # fmt: skip
    touch.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]
    return spec


def _object_spec(item: SceneObject) -> Any:
    """Return an object; the pose of a fixed object is part of the state of a simulation."""
    spec = _read(item.urdf_path.read_text(), str(item.urdf_path))
    for body in spec.bodies:
        for geom in body.geoms:
            geom.friction = _FRICTION
        _collide(body.geoms, *((_FIXED,) if item.fixed else (_LOOSE, _GROUND | _FIXED | _LOOSE)))
    root = spec.bodies[1]
    if item.fixed:
        root.mocap = True
    else:
        root.add_freejoint(name="free")
    return spec


def _read(urdf: str, path: str) -> Any:
    try:
        return mujoco.MjSpec.from_string(urdf.replace("</robot>", _COMPILER))
    except ValueError as error:
        raise KinfeasError(f"{path}: MuJoCo cannot load it: {error}") from error


def compiled(spec: Any, robot: Robot) -> Any:
    """Return MuJoCo's model of a specification."""
    try:
        return spec.compile()
    except ValueError as error:
        raise KinfeasError(f"{robot.urdf_path}: MuJoCo cannot load it: {error}") from error


def _collide(geoms: Iterable[Any], kind: int, others: int = 0) -> None:
    for geom in geoms:
        geom.contype, geom.conaffinity = kind, others
