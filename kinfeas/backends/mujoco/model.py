"""A robot in a room as one MuJoCo model, and the addresses of its parts."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.drives import ArmSetpoints, base_forces
from kinfeas.backends.physics.robot import (
    PLANAR_JOINTS,
    arm_followers,
    finger_followers,
    moving_joints,
    physics_urdf,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.objects import SceneObject
from kinfeas.scenes.scene import Scene

ROBOT, FLOOR = -2, -1
"""Owners of geoms that belong to no object of the scene."""

LAG = 0.02
"""Seconds by which servos lag behind a moving setpoint; their natural frequency is 2 / LAG."""

_UNUSED = (0.1, 0.1, 0.0, 0.2)  # size of an empty place
_OWN = "/robot:"  # no object has a slash in its name
# Bits of contype and conaffinity: fixed things do not collide with each other, the base not with
# the floor, and the robot not with itself.
_GROUND, _FIXED, _LOOSE = 1, 2, 4
_FRICTION = (0.5, 0.005, 0.0001)  # sliding (-), torsional and rolling (m)
_PAD_DIMENSIONS = 4  # of the fingers' contacts: they resist twisting, too
_IMPRATIO = 10.0  # impedance of friction relative to normal forces: objects creep less in the hand
_BASE_LAG = 0.005  # s, of the base's velocity
_COUPLING = (0.01, 1.0)  # time constant (s) and damping ratio of mimicking joints
# Time constant (s), damping ratio and impedance of a grasp: some thousand N/m, as fingers have.
_GRASP = (0.02, 1.0, 0.9, 0.9, 0.001, 0.5, 2.0)
_FINGER_COUPLING = 0.5  # of a finger's effort: largest force that keeps both equally far open
_COMPILER = (
    '<mujoco><compiler strippath="false" fusestatic="false" balanceinertia="true" '
    'boundmass="1e-4" boundinertia="1e-8"/></mujoco></robot>'
)


class Servo(NamedTuple):
    """A position motor of a joint: limits of its effort (N m or N) and velocity (per second)."""

    joint: str
    effort: float
    velocity: float


class Model:
    """A robot in a room, or on a floor only.

    Attributes:
        engine: MuJoCo's model. Its actuators are velocity motors of x, y and yaw, then `servos`,
            then one that keeps both fingers equally far open.
        robot: The robot.
        scene: The scene; None for a floor only.
        objects: Its objects by name.
        servos: Motors of the arm's joints, then of the fingers.
        velocity: Velocity limits of the servos, shape (s,).
        joints: Addresses in `qpos` and `qvel` of the robot's joints by name.
        at: The same of x, y, yaw and the joints of the servos, shape (2, 3 + s).
        arm_at: Addresses in `qpos` of the joints of `ArmSetpoints`.
        rest: `qpos` with the robot's joints outside the arm at `fixed_joints`.
        owner: Index of each body's object in the scene, `FLOOR` or `ROBOT`, shape (bodies,).
        on_arm: Whether each body is a link that the arm carries, shape (bodies,).
        fingers: Bodies of each finger.
        grasp: Index of the equality constraint of a grasp; None without one.
        grasped: Bodies of the hand and of the link that it can hold, with `grasp`.
        turns: Whether that link can turn in the hand.
        solid_bodies: Bodies of solids, shape (places,); as owners they follow the objects.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None,
        config: PhysicsConfig,
        grasped: tuple[str, str, bool] | None = None,
        places: int = 0,
    ) -> None:
        """Build the model; poses of objects, and `places` for solids, are those of a simulation.

        `grasped` is the object and link that the gripper can hold, and whether it cannot turn.
        """
        arm = ArmSetpoints(robot, config.arm_horizon)
        self.robot, self.scene, self.objects = robot, scene, dict(scene.objects) if scene else {}
        self.servos = _servos(robot, arm)
        self.velocity = np.array([one.velocity for one in self.servos])
        urdf, part_of = physics_urdf(robot)
        carried = {part_of[one] for joint in robot.arm for one in robot.urdf.below(joint.name)}
        grips = robot.gripper.fingers if robot.gripper else ()
        fingers = [{part_of[link] for link in robot.urdf.below(finger)} for finger in grips]

        spec = mujoco.MjSpec()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio, spec.option.iterations = _IMPRATIO, config.iterations
        spec.option.gravity = [0.0, 0.0, -config.gravity]
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        _collide([spec.worldbody.add_geom(type=plane, size=[0.0, 0.0, 1.0])], _GROUND)
        own = _robot_spec(robot, urdf, self.servos)
        for body in own.bodies[1:]:
            for geom in body.geoms:
                geom.group = 1
            _collide(body.geoms, 0, _FIXED | _LOOSE | (_GROUND if body.name in carried else 0))
            if any(body.name in links for links in fingers):
                for geom in body.geoms:
                    geom.condim = _PAD_DIMENSIONS
                    geom.friction = [config.finger_friction, *_FRICTION[1:]]
        spec.attach(own, prefix=_OWN, frame=spec.worldbody.add_frame())
        for name, one in self.objects.items():
            spec.attach(_object_spec(one), prefix=f"{name}:", frame=spec.worldbody.add_frame())
        solids = [_add_solid(spec, place) for place in range(places)]
        if grasped is not None:
            self._add_grasp(spec, *grasped)
        self.engine = engine = _compiled(spec, robot)

        joints = [engine.joint(number) for number in range(engine.njnt)]
        self.joints = {
            joint.name.removeprefix(_OWN): (int(joint.qposadr[0]), int(joint.dofadr[0]))
            for joint in joints
            if joint.name.startswith(_OWN)
        }
        driven = (*PLANAR_JOINTS, *(one.joint for one in self.servos))
        self.at = np.array([self.joints[name] for name in driven]).T
        self.arm_at = np.array([self.joints[name][0] for name in arm.names])
        self.rest = engine.qpos0.copy()
        for name in moving_joints(robot) & robot.fixed_joints.keys():
            self.rest[self.joints[name][0]] = robot.fixed_joints[name]
        names = [engine.body(number).name for number in range(engine.nbody)]
        owners = {
            "world": FLOOR,
            _OWN[:-1]: ROBOT,
            **{one: i for i, one in enumerate((*self.objects, *solids))},
        }
        self.owner = np.array([owners[name.partition(":")[0]] for name in names])
        self.on_arm = np.array([name.removeprefix(_OWN) in carried for name in names])
        self.solid_bodies = np.array([engine.body(name).id for name in solids], dtype=np.intp)
        self.fingers = [[engine.body(_OWN + link).id for link in links] for links in fingers]
        self.grasp = int(engine.equality("grasp").id) if grasped else None
        if grasped is not None:
            hand = int(engine.body(_OWN + robot.ee_frame).id)
            self.grasped, self.turns = (hand, self.body(*grasped[:2])), not grasped[2]
        self._tune(config, arm)

    def _add_grasp(self, spec: Any, name: str, link: str, rigid: bool) -> None:
        """Add a soft constraint between hand and object, which a grasp activates."""
        kind = mujoco.mjtEq.mjEQ_WELD if rigid else mujoco.mjtEq.mjEQ_CONNECT
        spec.add_equality(
            name="grasp", type=kind, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False,
            name1=_OWN + self.robot.ee_frame, name2=f"{name}:{link}", solref=_GRASP[:2],
            solimp=_GRASP[2:],
        )  # fmt: skip

    def body(self, name: str, link: str) -> int:
        """Return the body of a link of an object, or of the robot for an empty name."""
        return int(self.engine.body(f"{name}:{link}" if name else _OWN + link).id)

    def root(self, name: str) -> int:
        """Return the body of the root link of an object."""
        return self.body(name, self.objects[name].urdf.root)

    def address(self, name: str, joint: str) -> int:
        """Return the address in `qpos` of a joint of an object."""
        return int(self.engine.joint(f"{name}:{joint}").qposadr[0])

    def write(self, scene: Scene, qpos: Array, mocap: Array) -> None:
        """Write objects into `qpos` and poses of fixed ones, (mocap, 7), quaternions w first."""
        for name, one in scene.objects.items():
            pose = [*one.pose[:3], one.pose[6], *one.pose[3:6]]
            if one.fixed:
                mocap[self.engine.body_mocapid[self.root(name)]] = pose
            else:
                at = self.address(name, "free")
                qpos[at : at + 7] = pose
            for joint, position in one.joint_positions.items():
                qpos[self.address(name, joint)] = position

    def shapes(self, solids: Solids) -> dict[str, Array]:
        """Return the fields of the model that hold the shapes of solids, (n, k, ...), by name."""
        # MuJoCo would test shapes without a size against everything.
        size = np.where(solids.filled[..., np.newaxis], solids.size, _UNUSED)
        x, y, low, high = np.moveaxis(size, -1, 0)
        round_, z = solids.cylinder, (high - low) / 2.0
        box, none = np.stack([x, np.where(round_, x, y), z], axis=-1), np.zeros_like(x)
        size = np.where(round_[..., np.newaxis], np.stack([x, z, none], axis=-1), box)
        kinds = int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_BOX)
        radius = np.hypot(np.where(round_, x, np.hypot(x, y)), z)
        around = np.concatenate([np.zeros_like(box), box], axis=-1)
        return {
            "geom_type": np.where(round_, *kinds),
            "geom_size": size,
            "geom_rbound": radius,
            "geom_aabb": around,
            "bvh_aabb": around,
        }

    def solid_rows(self, name: str) -> NDArray[np.intp]:
        """Return the rows of solids in a field of `shapes`, shape (k,)."""
        rows = self.engine.body_bvhadr if name == "bvh_aabb" else self.engine.body_geomadr
        return np.asarray(rows[self.solid_bodies], dtype=np.intp)

    def _tune(self, config: PhysicsConfig, arm: ArmSetpoints) -> None:
        """Set the motors' inertias, gains and limits.

        Servos are critically damped for the inertia that they move. Their rotors are so heavy that
        damping times velocity limit is at least the effort limit: with a setpoint within
        `LAG * velocity` of its joint, a servo has its full effort at rest and keeps its velocity
        limit, and it does not chatter where its effort is limited.
        """
        engine = self.engine
        strongest = np.array([one.effort for one in self.servos])
        finite = np.where(np.isfinite(strongest), strongest, 0.0)
        engine.dof_armature[self.at[1, 3:]] = LAG / 4.0 * finite / self.velocity
        mujoco.mj_setConst(engine, mujoco.MjData(engine))
        inertia = self._inertia(arm)
        mass = float(engine.body_subtreemass[engine.body(_OWN + self.robot.urdf.root).id])
        inertia[:2] = mass
        forces = base_forces(self.robot, config, mass, float(inertia[2]))
        limits = np.concatenate([forces, strongest])
        if self.fingers:  # the tendon between them
            limits = np.append(limits, _FINGER_COUPLING * strongest[-1])
            inertia = np.append(inertia, inertia[-1] / 2.0)
        damping = inertia * np.where(np.arange(len(inertia)) < 3, 1.0 / _BASE_LAG, 4.0 / LAG)
        engine.actuator_gainprm[:, 0] = [*damping[:3], *(damping[3:] / LAG)]
        engine.actuator_biasprm[3:, 1] = -damping[3:] / LAG
        engine.actuator_biasprm[:, 2] = -damping
        engine.actuator_forcelimited[:] = np.isfinite(limits)
        engine.actuator_forcerange[:] = np.column_stack([-limits, limits])

    def _inertia(self, arm: ArmSetpoints) -> Array:
        """Return the largest inertia at each actuator in the robot's named configurations."""
        engine, data = self.engine, mujoco.MjData(self.engine)
        moved, found = np.zeros((len(self.at[1]), engine.nv)), []
        moved[np.arange(len(moved)), self.at[1]] = 1.0
        driven = [*PLANAR_JOINTS, *(one.joint for one in self.servos)]
        for one in (*arm_followers(self.robot), *finger_followers(self.robot)):
            moved[driven.index(one.leader), self.joints[one.name][1]] = one.multiplier
        for joints in self.robot.home.values():
            data.qpos[:] = self.rest
            data.qpos[self.arm_at] = arm.follow(joints)
            mujoco.mj_forward(engine, data)
            matrix = np.zeros((engine.nv, engine.nv))
            mujoco.mj_fullM(engine, data, matrix)
            found.append(np.einsum("ij,jk,ik->i", moved, matrix, moved))
        return np.max(found, axis=0)


def _servos(robot: Robot, arm: ArmSetpoints) -> list[Servo]:
    """Return the motors of the arm, and of the fingers; mimicking joints have none."""
    limits = zip(arm.names, arm.effort, arm.velocity, strict=True)
    servos = [Servo(*one) for one, _ in zip(limits, robot.arm, strict=False)]
    if robot.gripper is not None:
        for name in robot.gripper.fingers:
            servos.append(Servo(name, robot.gripper.effort, robot.urdf.joints[name].velocity))
    return servos


def _robot_spec(robot: Robot, urdf: str, servos: Iterable[Servo]) -> Any:
    """Return the robot with actuators, couplings of mimicking joints, and a sensor of contacts."""
    spec = _read(urdf, str(robot.urdf_path))
    for body in spec.bodies:
        body.gravcomp = 1.0
    for joint in spec.joints:
        joint.frictionloss = 0.0  # of the gears, which the motors overcome
        if joint.name in PLANAR_JOINTS:
            joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        # Motors carry the weight with their effort, springs carry it beside them.
        joint.actgravcomp = joint.name not in robot.counterbalanced
    for one in (*arm_followers(robot), *finger_followers(robot)):
        coupling = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=one.name, name2=one.leader, solref=_COUPLING
        )
        coupling.data[:2] = one.offset, one.multiplier
    for name in (*PLANAR_JOINTS, *(one.joint for one in servos)):
        spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
    if robot.gripper is not None:
        # Both fingers open equally far, up to a force: they also close round an object off centre.
        tendon = spec.add_tendon(name="fingers")
        for finger, share in zip(robot.gripper.fingers, (1.0, -1.0), strict=True):
            tendon.wrap_joint(finger, share)
        spec.add_actuator(
            name="fingers", target="fingers", trntype=mujoco.mjtTrn.mjTRN_TENDON,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
    touch = spec.add_sensor(
        name="touch", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=robot.urdf.root,
    )  # fmt: skip
    touch.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]
    return spec


def _object_spec(one: SceneObject) -> Any:
    """Return an object; the pose of a fixed one is part of the state of a simulation."""
    spec = _read(one.urdf_path.read_text(), str(one.urdf_path))
    for body in spec.bodies:
        for geom in body.geoms:
            geom.friction = _FRICTION
        _collide(body.geoms, *((_FIXED,) if one.fixed else (_LOOSE, _GROUND | _FIXED | _LOOSE)))
    root = spec.bodies[1]
    if one.fixed:
        root.mocap = True
    else:
        root.add_freejoint(name="free")
    return spec


def _add_solid(spec: Any, place: int) -> str:
    """Add a body for a solid; its shape and its pose are those of a simulation."""
    name = f"/solid{place}"
    body = spec.worldbody.add_body(name=name, mocap=True)
    geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1] * 3, friction=_FRICTION)
    _collide([geom], _FIXED)
    return name


def _read(urdf: str, path: str) -> Any:
    try:
        return mujoco.MjSpec.from_string(urdf.replace("</robot>", _COMPILER))
    except ValueError as error:
        raise KinfeasError(f"{path}: MuJoCo cannot load it: {error}") from error


def _compiled(spec: Any, robot: Robot) -> Any:
    try:
        return spec.compile()
    except ValueError as error:
        raise KinfeasError(f"{robot.urdf_path}: MuJoCo cannot load it: {error}") from error


def _collide(geoms: Iterable[Any], kind: int, others: int = 0) -> None:
    for geom in geoms:
        geom.contype, geom.conaffinity = kind, others
