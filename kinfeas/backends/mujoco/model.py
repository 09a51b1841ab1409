"""A robot in a room as one MuJoCo model, and the addresses of its joints and bodies."""

import mujoco
import numpy as np

from kinfeas.backends.mujoco.spec import (
    OWN,
    SOLID,
    RobotBodies,
    add_grasp,
    bodies_of,
    compiled,
    room_spec,
    servos_of,
)
from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.drives import ArmSetpoints, base_forces
from kinfeas.backends.physics.robot import (
    PLANAR_JOINTS,
    arm_followers,
    finger_followers,
    moving_joints,
)
from kinfeas.core.motion import Rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene

ROBOT, FLOOR = -2, -1
"""Owners of geoms that belong to no object of the scene."""

LAG = 0.02
"""Seconds by which servos lag behind a moving setpoint; their natural frequency is 2 / LAG."""

_BASE_LAG = 0.005  # s, time constant of the base's velocity
_FINGER_COUPLING = 0.5  # of a finger's effort: largest force that keeps both equally far open
_UNUSED = (0.1, 0.1, 0.0, 0.2)  # m, `Solids.size` that stands for that of an empty place


class Model:
    """A robot in a room, or on a floor only.

    Attributes:
        engine: MuJoCo's model. Its actuators are velocity motors of x, y and yaw, then `servos`,
            then one that keeps both fingers equally far open.
        robot: The robot.
        scene: The scene; None for a floor only.
        objects: Its objects by name.
        servos: Motors of the arm's joints, then of the fingers.
        velocity: Velocity limits of the servos, shape (s,), rad/s or m/s.
        joints: Addresses in `qpos` and `qvel` of the robot's joints by name.
        at: Addresses in `qpos` and in `qvel` of x, y, yaw and the servos' joints, shape (2, 3 + s).
        arm_at: Addresses in `qpos` of the joints of `ArmSetpoints`.
        rest: `qpos` with the robot's joints outside the arm at `fixed_joints`.
        owner: Index of each body's object in the scene, `FLOOR` or `ROBOT`, shape (bodies,).
        on_arm: Whether each body is a link that the arm carries, shape (bodies,).
        fingers: Bodies of each finger.
        grasp: Index of the equality constraint of a grasp; None without one.
        grasped: Bodies of the hand and of the link that it can hold; missing without `grasp`.
        turns: Whether that link can turn in the hand; missing without `grasp`.
        solid_bodies: Bodies of solids, shape (places,); in `owner` they come after the objects.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None,
        config: PhysicsConfig,
        grasped: tuple[str, str, bool] | None = None,
        places: int = 0,
    ) -> None:
        """Build the model with `places` for solids; each simulation sets the poses of its objects.

        `grasped` has an object and its link that the gripper can hold, and whether rigidly.
        """
        arm = ArmSetpoints(robot, config.arm_horizon)
        self.robot, self.scene, self.objects = robot, scene, dict(scene.objects) if scene else {}
        self.servos = servos_of(robot, arm)
        self.velocity = np.array([servo.velocity for servo in self.servos])
        bodies = bodies_of(robot)
        spec = room_spec(robot, bodies, self.servos, self.objects, places, config)
        if grasped is not None:
            add_grasp(spec, robot, *grasped[:2], rigid=grasped[2])
        self.engine = engine = compiled(spec, robot)

        self._find_joints(arm)
        self._find_bodies(bodies, places)
        self.grasp = None
        if grasped is not None:
            self.grasp = int(engine.equality("grasp").id)
            hand = int(engine.body(OWN + robot.ee_frame).id)
            self.grasped, self.turns = (hand, self.body(*grasped[:2])), not grasped[2]
        self._tune(config, arm)

    def body(self, name: str, link: str) -> int:
        """Return the body of a link of an object, or of the robot for an empty name."""
        return self._bodies[f"{name}:{link}" if name else OWN + link]

    def base_meshes(self) -> list[Array]:
        """Return the vertices of the base's collision meshes in its frame, (v, 3), metres."""
        engine, data, meshes = self.engine, mujoco.MjData(self.engine), []
        data.qpos[:] = self.rest
        mujoco.mj_kinematics(engine, data)
        of_base = ((self.owner == ROBOT) & ~self.on_arm)[engine.geom_bodyid]
        of_base &= engine.geom_type == mujoco.mjtGeom.mjGEOM_MESH
        for geom in np.flatnonzero(of_base):
            mesh = engine.mesh(engine.geom_dataid[geom])
            first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            vertices = engine.mesh_vert[first : first + count]
            turned = vertices @ data.geom_xmat[geom].reshape(3, 3).T
            meshes.append(turned + data.geom_xpos[geom])
        return meshes

    def root(self, name: str) -> int:
        """Return the body of the root link of an object."""
        return self.body(name, self.objects[name].urdf.root)

    def address(self, name: str, joint: str) -> int:
        """Return the address in `qpos` of a joint of an object."""
        return int(self.engine.joint(f"{name}:{joint}").qposadr[0])

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
            "geom_type": np.where(round_, *kinds), "geom_size": size, "geom_rbound": radius,
            "geom_aabb": around, "bvh_aabb": around,
        }  # fmt: skip

    def solid_rows(self, name: str) -> Rows:
        """Return the indices of solids in the model's field `name`, as of `shapes`, shape (k,)."""
        rows = self.engine.body_bvhadr if name == "bvh_aabb" else self.engine.body_geomadr
        return np.asarray(rows[self.solid_bodies], dtype=np.intp)

    def _find_joints(self, arm: ArmSetpoints) -> None:
        engine, robot = self.engine, self.robot
        joints = [engine.joint(number) for number in range(engine.njnt)]
        self.joints = {
            joint.name.removeprefix(OWN): (int(joint.qposadr[0]), int(joint.dofadr[0]))
            for joint in joints
            if joint.name.startswith(OWN)
        }
        driven = (*PLANAR_JOINTS, *(servo.joint for servo in self.servos))
        self.at = np.array([self.joints[name] for name in driven]).T
        self.arm_at = np.array([self.joints[name][0] for name in arm.names])
        self.rest = engine.qpos0.copy()
        for name in moving_joints(robot) & robot.fixed_joints.keys():
            self.rest[self.joints[name][0]] = robot.fixed_joints[name]

    def _find_bodies(self, bodies: RobotBodies, places: int) -> None:
        engine, solids = self.engine, [f"{SOLID}{place}" for place in range(places)]
        names = [engine.body(number).name for number in range(engine.nbody)]
        self._bodies = {name: number for number, name in enumerate(names)}
        owners = {name: number for number, name in enumerate((*self.objects, *solids))}
        owners |= {"world": FLOOR, OWN[:-1]: ROBOT}
        self.owner = np.array([owners[name.partition(":")[0]] for name in names])
        self.on_arm = np.array([name.removeprefix(OWN) in bodies.carried for name in names])
        self.solid_bodies = np.array([engine.body(name).id for name in solids], dtype=np.intp)
        self.fingers = [[engine.body(OWN + link).id for link in links] for links in bodies.fingers]

    def _tune(self, config: PhysicsConfig, arm: ArmSetpoints) -> None:
        """Set the motors' inertias, gains and limits.

        Servos are critically damped for the inertia that they move. Their rotors are so heavy that
        damping times velocity limit is at least the effort limit: with a setpoint within
        `LAG * velocity` of its joint, a servo has its full effort at rest and keeps its velocity
        limit, and it does not chatter where its effort is limited. Without an effort limit, a rotor
        is as heavy as what it moves.
        """
        engine = self.engine
        strongest = np.array([servo.effort for servo in self.servos])
        rotors = LAG / 4.0 * strongest / self.velocity
        if (unlimited := ~np.isfinite(strongest)).any():
            rotors[unlimited] = self._inertia(arm)[3:][unlimited]
        engine.dof_armature[self.at[1, 3:]] = rotors
        mujoco.mj_setConst(engine, mujoco.MjData(engine))
        inertia = self._inertia(arm)
        mass = float(engine.body_subtreemass[engine.body(OWN + self.robot.urdf.root).id])
        inertia[:2] = mass
        forces = base_forces(self.robot, config, mass, float(inertia[2]))
        limits = np.concatenate([forces, strongest])
        gripper = self.robot.gripper
        if gripper is not None:  # the tendon between the fingers
            limits = np.append(limits, _FINGER_COUPLING * strongest[-1])
            inertia = np.append(inertia, inertia[-1] / 2.0)
        damping = inertia * np.where(np.arange(len(inertia)) < 3, 1.0 / _BASE_LAG, 4.0 / LAG)
        engine.actuator_gainprm[:, 0] = [*damping[:3], *(damping[3:] / LAG)]
        engine.actuator_biasprm[3:, 1] = -damping[3:] / LAG
        engine.actuator_biasprm[:, 2] = -damping
        if gripper is not None:  # the tendon's length at all openings
            first, second = gripper.positions("close").values()
            length = first - second / gripper.ratio
            engine.actuator_biasprm[-1, 0] = damping[-1] / LAG * length
        engine.actuator_forcelimited[:] = np.isfinite(limits)
        engine.actuator_forcerange[:] = np.column_stack([-limits, limits])

    def _inertia(self, arm: ArmSetpoints) -> Array:
        """Return the largest inertia at each actuator in the robot's named configurations."""
        engine, data = self.engine, mujoco.MjData(self.engine)
        moved, inertias = np.zeros((len(self.at[1]), engine.nv)), []
        moved[np.arange(len(moved)), self.at[1]] = 1.0
        driven = [*PLANAR_JOINTS, *(servo.joint for servo in self.servos)]
        for mimic in (*arm_followers(self.robot), *finger_followers(self.robot)):
            moved[driven.index(mimic.leader), self.joints[mimic.name][1]] = mimic.multiplier
        for joints in self.robot.home.values():
            data.qpos[:] = self.rest
            data.qpos[self.arm_at] = arm.follow(joints)
            mujoco.mj_forward(engine, data)
            matrix = np.zeros((engine.nv, engine.nv))
            mujoco.mj_fullM(engine, data, matrix)
            inertias.append(np.einsum("ij,jk,ik->i", moved, matrix, moved))
        return np.max(inertias, axis=0)
