"""Simulations of a MuJoCo model, their motors and grippers, stepped side by side."""

from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from kinfeas.backends.mujoco.model import LAG, ROBOT, Model
from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.drives import ArmSetpoints, base_path
from kinfeas.control.execution import tool_pose
from kinfeas.core.backend import Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, relative, yaw
from kinfeas.scenes.scene import Scene

_FIELDS = (
    "time", "qpos", "qvel", "act", "qacc_warmstart", "ctrl", "eq_active", "mocap_pos", "mocap_quat",
)  # fmt: skip
_SCALED = (
    ("body_mass", "body_inertia"), ("geom_friction",), ("actuator_gainprm", "actuator_biasprm"),
)  # fmt: skip
_AWAY = [0.0, 0.0, -100.0, 1.0, 0.0, 0.0, 0.0]  # pose of empty places, quaternion w first


class Simulations:
    """n simulations of a model, the setpoints of their motors, and their start states.

    Attributes:
        n: Number of simulations.
        batch: MuJoCo's states.
        fingers: Setpoints of the fingers, shape (n, 2), rad or m.
        dynamics: Factors on the robot's masses, all frictions and the arm's gains, shape (n, 3).
        touches: Number of the robot's contacts in the last physics step, shape (n,).
    """

    def __init__(self, model: Model, config: PhysicsConfig, n: int) -> None:
        """Make n simulations; call `reset` next."""
        self.model, self.n, self.batch = model, n, Batch(model.engine, n)
        self._config, engine, robot = config, model.engine, model.robot
        self._arm = ArmSetpoints(robot, config.arm_horizon, n)
        names = [servo.joint for servo in model.servos[len(robot.arm) :]]
        self._at_rest = np.array([robot.fixed_joints[name] for name in names])
        self.fingers = np.tile(self._at_rest, (n, 1))
        self.dynamics = np.ones((n, len(_SCALED)))
        self._scaled: dict[str, Array] = {}
        self._base = np.zeros((n, 3))  # velocity setpoints, as in `base_path`
        self._qpos = np.tile(model.rest, (n, 1))
        self._mocap = np.zeros((n, engine.nmocap, 7))
        solids = engine.body_mocapid[model.solid_bodies]
        self._mocap[:, solids], self.batch.mocap_pos[:, solids] = _AWAY, _AWAY[:3]
        if model.scene is not None:
            for row in range(n):
                self.arrange(row, model.scene)
        self._scratch = mujoco.MjData(engine)
        self.touches = self.batch.sensordata[:, 0]
        self._closing = np.zeros(n, dtype=np.bool_)
        # Where hand and object are held together, in the frames of both.
        grasps = model.grasp is not None
        self._ends = self.batch.expand("eq_data")[:, -1] if grasps else np.zeros((n, 0))
        self._tip = tool_pose(robot)
        self._time_step = self.batch.expand("opt.timestep")
        self.qpos, self.qvel = self.batch.qpos, self.batch.qvel
        self._warning, self._active = self.batch.warning, self.batch.eq_active
        shapes = model.shapes(Solids.empty(1)) if model.solid_bodies.size else ()
        self._shapes = {name: self.batch.expand(name) for name in shapes}
        # Compile the kernel now: a control period of a deployed robot cannot wait for it.
        self._base_path(np.arange(0), np.zeros((0, 6)), np.zeros(1))

    def state(self) -> dict[str, Any]:
        """Return the arrays of n rows that hold the state, by name; writing to them changes it."""
        return {
            "physics_state": self.batch.state,
            "physics_arm": self._arm.at,
            "physics_arm_velocity": self._arm.speed,
            "physics_base": self._base,
            "physics_fingers": self.fingers,
            "physics_start": self._qpos,
            "physics_objects": self._mocap,
            "physics_closing": self._closing,
            "physics_grasp": self._ends,
            "physics_dynamics": self.dynamics,
        }

    def adopt(self, other: "Simulations") -> None:
        """Continue from fewer simulations, or from a model with fewer places for solids."""
        own, old = self.state() | self._shapes, other.state() | other._shapes
        pairs = [(own[key], old[key]) for key in own.keys() & old.keys() - {"physics_state"}]
        pairs += [(getattr(self.batch, name), getattr(other.batch, name)) for name in _FIELDS]
        for mine, values in pairs:  # `mine` is at least as long along each axis
            mine[tuple(slice(size) for size in values.shape)] = values
        self.scale_dynamics(np.arange(other.n))

    def scale_dynamics(self, rows: Rows) -> None:
        """Apply the factors `dynamics` of some simulations to their models."""
        if not self._scaled and np.all(self.dynamics == 1.0):
            return
        model = self.model
        arm = 3 + np.arange(len(model.robot.arm))  # after the base
        indices = (np.flatnonzero(model.owner == ROBOT), np.arange(model.engine.ngeom), arm)
        for factors, names, at in zip(self.dynamics[rows].T, _SCALED, indices, strict=True):
            for name in names:
                nominal = getattr(model.engine, name)
                if name not in self._scaled:
                    self._scaled[name] = self.batch.expand(name)
                values = self._scaled[name]
                wide = factors.reshape(-1, *[1] * nominal.ndim)
                values[np.ix_(rows, at)] = wide * nominal[at]
        self.batch.set_const(rows)

    def place_solids(self, rows: Rows, solids: Solids) -> None:
        """Set shapes and poses of the solids of the m simulations `rows`; `solids` has m rows."""
        for name, values in self.model.shapes(solids).items():
            at = self.model.solid_rows(name)[: solids.places]
            self._shapes[name][np.ix_(rows, at)] = values
        self.move_solids(rows, solids)

    def move_solids(self, rows: Rows, solids: Solids) -> None:
        """Set the poses of the solids of the m simulations `rows`; `solids` has m rows."""
        centre = solids.centre
        pose = np.concatenate([centre[..., :3], np.roll(centre[..., 3:], 1, axis=-1)], axis=-1)
        pose = np.where(solids.filled[..., np.newaxis], pose, _AWAY)
        bodies = self.model.solid_bodies[: solids.places]
        at = np.ix_(rows, self.model.engine.body_mocapid[bodies])
        self.batch.mocap_pos[at], self.batch.mocap_quat[at] = pose[..., :3], pose[..., 3:]

    def arrange(self, row: int, scene: Scene) -> None:
        """Set the objects of a simulation as in a scene, from the next reset on."""
        model, qpos, mocap = self.model, self._qpos[row], self._mocap[row]
        for name, item in scene.objects.items():
            pose = [*item.pose[:3], item.pose[6], *item.pose[3:6]]  # quaternion w first
            if item.fixed:
                mocap[model.engine.body_mocapid[model.root(name)]] = pose
            else:
                at = model.address(name, "free")
                qpos[at : at + 7] = pose
            for joint, position in item.joint_positions.items():
                qpos[model.address(name, joint)] = position

    def reset(self, rows: Rows, base_pose: Array, joint_positions: Array) -> None:
        """Place robots and objects at rest: base poses (m, 7), arm joints (m, j)."""
        batch, model = self.batch, self.model
        batch.reset(rows, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        qpos = self._qpos[rows]
        qpos[:, model.at[0, :2]], qpos[:, model.at[0, 2]] = base_pose[:, :2], yaw(base_pose)
        qpos[:, model.arm_at] = self._arm.follow(joint_positions)
        self.qpos[rows] = qpos
        batch.mocap_pos[rows] = self._mocap[rows, :, :3]
        batch.mocap_quat[rows] = self._mocap[rows, :, 3:]
        self._arm.reset(joint_positions, rows)
        self._base[rows], self.fingers[rows], self._closing[rows] = 0.0, self._at_rest, False

    def step(
        self, rows: Rows, base_twist: Array, joint_targets: Array, dt: float, steps: int
    ) -> None:
        """Simulate `dt` seconds in `steps` steps: world twists (m, 6), joint targets (m, j)."""
        model = self.model
        self._time_step[rows] = dt / steps
        time = dt / steps * np.arange(1.0, steps + 1.0)
        control = np.zeros((len(rows), steps, model.engine.nu))
        control[..., :3] = self._base_path(rows, base_twist, time)
        path, speed = self._arm.plan(joint_targets, time, rows)
        arm, servos = joint_targets.shape[1], control[..., 3 : model.at.shape[1]]
        servos[..., :arm] = (path + LAG * speed)[..., :arm]
        servos[..., arm:] = self.fingers[rows, np.newaxis]
        # A setpoint far ahead of its joint would exceed the velocity limit.
        now = self.qpos[rows][:, np.newaxis, model.at[0, 3:]]
        ahead = model.velocity * (LAG + time[:, np.newaxis])
        np.clip(servos, now - ahead, now + ahead, out=servos)
        self.batch.rollout(steps, control, record=(), ids=rows)
        if self._warning[rows].any():
            raise KinfeasError("MuJoCo: the simulation is unstable; try a higher 'physics.rate'")
        if model.grasp is not None:
            for row in rows[self.held[rows]].tolist():
                if self._grasp_force(row) > self._config.grasp_limit:
                    self._active[row, model.grasp] = 0.0
            # An object that has slipped out is not grasped again.
            for row in rows[self._closing[rows]].tolist():
                self._closing[row] = not self._hold(row)

    def _base_path(self, rows: Rows, twist: Array, time: Array) -> Array:
        """Return the setpoints of bases at world twists (m, 6), shape (m, t, 3)."""
        base, yaws = self.model.robot.base, self.qpos[:, self.model.at[0, 2]]
        differential = base.drive == "differential"
        limits = base.max_acceleration, base.max_rotation_acceleration
        return base_path(self._base, rows, twist, yaws, time, differential, *limits)

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether each hand holds something, shape (n,)."""
        if self.model.grasp is None:
            return np.zeros(self.n, dtype=np.bool_)
        return self._active[:, self.model.grasp] > 0.0

    def grip(self, grip: Grip, rows: Rows) -> None:
        """Start to close or open the grippers of some simulations."""
        gripper = self.model.robot.gripper
        assert gripper is not None
        self._closing[rows] = grip == "close"
        self.fingers[rows] = list(gripper.positions(grip).values())
        if self.model.grasp is not None and grip == "open":
            self._active[rows, self.model.grasp] = 0.0

    def _hold(self, row: int) -> bool:
        """Hold the object in the hand if both fingers touch it; return whether they do."""
        model, (hand, link) = self.model, self.model.grasped
        bodies, _ = self.contacts(row)
        touching = bodies[(bodies == link).any(axis=1)]
        if not all(np.isin(touching, finger).any() for finger in model.fingers):
            return False
        hand_pose, link_pose = self.poses(row, [hand, link])
        tip = compose(hand_pose, self._tip)
        in_hand, in_link = self._tip[:3], relative(tip, link_pose)[:3]
        rotation = np.roll(relative(link_pose, hand_pose)[3:], 1)
        if model.turns:
            self._ends[row, :6] = [*in_hand, *in_link]
        else:
            self._ends[row, :10] = [*in_link, *in_hand, *rotation]
        self._active[row, model.grasp] = 1.0
        # The fingers stay where they are: the constraint holds the object, not their force.
        self.fingers[row] = self.qpos[row, model.at[0, -2:]]
        return True

    def _grasp_force(self, row: int) -> float:
        engine, data, grasp = self.model.engine, self._scratch, self.model.grasp
        engine.eq_data[grasp] = self._ends[row]
        self._take(row)
        mujoco.mj_forward(engine, data)
        equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        return float(np.linalg.norm(data.efc_force[equality & (data.efc_id == grasp)][:3]))

    def poses(self, row: int, bodies: list[int]) -> Array:
        """Return the world poses of bodies of a simulation, shape (k, 7)."""
        data = self.data(row)
        return np.hstack([data.xpos[bodies], np.roll(data.xquat[bodies], -1, axis=1)])

    def contacts(self, row: int) -> tuple[NDArray[np.int32], Array]:
        """Return the bodies that touch, shape (c, 2), and the normals from first to second."""
        contact = self.data(row).contact
        near = contact.dist <= 0.0
        return self.model.engine.geom_bodyid[contact.geom[near]], contact.frame[near, :3]

    def data(self, row: int) -> Any:
        """Return MuJoCo's data at a simulation's present positions; the next call overwrites it."""
        self._take(row)
        mujoco.mj_fwdPosition(self.model.engine, self._scratch)
        return self._scratch

    def _take(self, row: int) -> None:
        """Copy the state of a simulation to `_scratch`, and its solids' shapes to the model."""
        self.batch.get_data(row, self._scratch)
        for name, values in self._shapes.items():
            at = self.model.solid_rows(name)
            getattr(self.model.engine, name)[at] = values[row, at]
