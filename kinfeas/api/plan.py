"""Plans of base and arm along EE paths, and their files."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike

from kinfeas.api import Name
from kinfeas.api.load import checked, load_robot, text_of
from kinfeas.api.reach import base_pose, placer_of, solids_of
from kinfeas.api.view import write_files
from kinfeas.config import Settings, nested
from kinfeas.control.execution import tool_pose
from kinfeas.control.observation import HORIZON
from kinfeas.control.subgoal_motions import LONGEST, begin_motions
from kinfeas.core.checks import ee_poses
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new, read_csv, write_csv
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import (
    IDENTITY,
    Array,
    compose,
    distance,
    interpolated,
    make_pose,
    relative,
    rotation,
)
from kinfeas.core.start import Start
from kinfeas.io.demonstrations import check_samples, columns
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.reach import BasePlacer
from kinfeas.planning.whole_body import Moments, State, plan_along
from kinfeas.plugins.waypoints import read_waypoints
from kinfeas.robots.robot import Base, Robot
from kinfeas.scenes.scene import Scene
from kinfeas.tasks.task import MotionSpec, Subgoal, build_subgoals

if TYPE_CHECKING:
    from kinfeas.viz.replay import EpisodeReplay

_BASE = ("x", "y", "yaw")
_AT_START, _TURNED = 0.02, 0.05  # distance at which the EE counts as at a pose, metres and radians
_ROUNDING = 1e-6  # tolerance for numbers that were rounded in a file
_ASIDE, _SLIPPING = 1e-3, 0.1  # sideways motion of a differential base: m, and fraction of path
_SLOWER = 0.5  # fraction of the base's speed to which an EE that exceeds it is slowed down


@dataclass(frozen=True, eq=False)
class Plan(Moments):
    """Base, arm and EE at t times, within the velocity limits and free of collisions."""

    robot: Robot
    solids: Solids | None = None  # solids in the world, one row; None without any

    def __repr__(self) -> str:
        return f"Plan({self.robot.name!r}, {self.time[-1]:.1f} s, {len(self.time)} moments)"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm joints."""
        return tuple(joint.name for joint in self.robot.arm)

    @property
    def reached(self) -> Array:
        """World poses of the EE by forward kinematics, (t, 7): `ee_pose` within the tolerance."""
        return compose(self.base_pose, forward(build_chain(self.robot), self.joint_positions))

    def save(self, path: Name) -> None:
        """Write a new CSV file: time, base x y yaw, arm joints by name, and the EE pose.

        The generator `replay` follows its EE poses, `kinfeas deploy --plan` also base and arm.
        """
        check_new(path)
        names = ["time", *_BASE, *_joint_columns(self.robot), *columns("ee_pose")]
        table = np.column_stack([self.time, self.base, self.joint_positions, self.ee_pose])
        rows = [[f"{value:.9g}" for value in row] for row in table.tolist()]
        write_csv(Path(path), names, rows)

    def joint_trajectory(self) -> dict[str, object]:
        """Return the arm motion as plain data, in the form of trajectory_msgs/JointTrajectory."""
        points = [
            {"positions": joints, "time_from_start": _stamp(seconds)}
            for joints, seconds in zip(
                self.joint_positions.tolist(), self.time.tolist(), strict=True
            )
        ]
        return {"header": _header(0.0, ""), "joint_names": list(self.joint_names), "points": points}

    def base_path(self, frame: str = "map") -> dict[str, object]:
        """Return the base motion as plain data, in the form of nav_msgs/Path; stamps begin at 0."""
        poses = [
            {
                "header": _header(seconds, frame),
                "pose": {
                    "position": dict(zip("xyz", pose[:3], strict=True)),
                    "orientation": dict(zip("xyzw", pose[3:], strict=True)),
                },
            }
            for pose, seconds in zip(self.base_pose.tolist(), self.time.tolist(), strict=True)
        ]
        return {"header": _header(0.0, frame), "poses": poses}

    def picture(self, path: Name) -> None:
        """Draw the plan from the side and from above as PNG."""
        replay = self._replay()
        write_files(replay, self.robot, picture=path, title=replay.title)

    def html(self, path: Name) -> None:
        """Write an interactive page on which the robot moves as planned."""
        write_files(self._replay(), self.robot, html=path)

    def _replay(self) -> "EpisodeReplay":
        from kinfeas.viz.replay import Recording, replay_of

        feasible = np.ones(len(self.time), dtype=np.bool_)
        recording = Recording(
            0, self.time, self.base_pose, self.joint_positions, self.ee_pose, self.reached,
            feasible, self.ee_pose[-1:], reached=True, solids=self.solids,
        )  # fmt: skip
        return replay_of(recording, self.robot, f"{self.robot.name}, plan of {self.time[-1]:.0f} s")


def plan(  # noqa: PLR0913 - options of the command
    robot: Name | Robot | BasePlacer,
    path: Name | ArrayLike,
    *,
    target: ArrayLike | None = None,
    step: float = HORIZON,
    start: Sequence[float] | None = None,
    joints: Sequence[float] | None = None,
    scene: Name | Scene | None = None,
    solids: Solids | ArrayLike | None = None,
    settings: Settings | None = None,
) -> Plan:
    """Return a plan of base and arm along an EE path.

    Example: `kinfeas.plan("pr2", "ee.csv", scene="room").save("plan.csv")`

    Args:
        robot: Name, folder, loaded robot, or a `BasePlacer` of `kinfeas.planning.reach`.
        path: World poses of the EE, shape (k, 7), every `step` seconds, or later where the EE would
            be faster than the base; a file of poses, as for the generator `waypoints`; or the name
            of a motion generator, which needs a `target`.
        target: World pose at which the motion of a generator ends, shape (7,).
        step: Time from a pose to the next, seconds. Only for arrays of poses; files and generators
            have their own time.
        start: Current x, y and yaw of the base, metres and radians. The EE first moves from its
            current pose to the path. By default the plan begins at a base pose that suits the path.
        joints: Current arm joints, shape (j,), radians or metres; those of home by default.
        scene: Scene, or its name or YAML file. Base and arm avoid its objects, except movable ones
            within 5 cm of the tool tip at one of the poses: these count as grasped.
        solids: Other solids in the world: one row of `kinfeas.core.solids.Solids`, or a table of
            shape (m, 11).
        settings: Parameters of the motion generator, such as `max_velocity`.

    Raises:
        KinfeasError: If an argument is invalid, or no plan was found. The error names the first EE
            pose that is out of reach, with the reason.
    """
    step = checked(Annotated[float, Interval(ge=1e-3, le=10.0)], step, "step")
    if joints is not None and start is None:
        raise KinfeasError("'joints' needs 'start'")
    if isinstance(path, str | Path):
        if step != HORIZON:
            raise KinfeasError("'step' is for poses, not for files and generators")
        motion, poses = _motion(path, target, start, settings)
    elif nested(settings) or target is not None:
        raise KinfeasError("'settings' are for files and generators, 'target' for generators")
    elif len(poses := ee_poses(path, "path")) < 2:
        raise KinfeasError("'path' must have at least 2 poses")
    placer = placer_of(robot)
    model = placer.solver.robot
    around, names = solids_of(scene, solids, compose(poses, tool_pose(model)))
    state = None if start is None else _state(model, start, joints)
    if isinstance(path, str | Path):
        ee = _rolled_out(placer.solver, motion, poses, state, around)
        if len(ee) * HORIZON >= LONGEST:
            raise KinfeasError(f"{path}: the EE motion takes longer than {LONGEST:g} s")
    else:
        if state is not None:
            poses = _from_start(placer.solver, *state, poses)
        ee, step = _divided(poses, step, model.base)
    moments = plan_along(placer, ee, step, state, around, names)
    return Plan(**vars(moments), robot=model, solids=around)


def load_plan(path: Name, robot: Name, *, scene: Name | Scene | None = None) -> Plan:
    """Return the plan of a file for a robot; the scene only appears in its pictures.

    Raises:
        KinfeasError: If the file is no plan of the robot, or beyond the limits of base or arm.
    """
    model, file = load_robot(robot), Path(text_of(path, "path"))
    joints = _joint_columns(model)
    values = read_csv(file, ["time", *_BASE, *joints, *columns("ee_pose")])
    base, arm, ee = (
        np.stack([values[name] for name in names], axis=1)
        for names in (_BASE, joints, columns("ee_pose"))
    )
    check_samples(file, values["time"], {"ee_pose": ee})
    ee = make_pose(ee[:, :3], rotation(ee))
    # Other programs write angles within one turn.
    base[:, 2] = np.unwrap(base[:, 2])
    arm[:, model.continuous] = np.unwrap(arm[:, model.continuous], axis=0)
    seconds = values["time"] - values["time"][0]
    plan = Plan(seconds, base, arm, ee, model, solids_of(scene, None)[0])
    _check_plan(file, plan)
    return plan


def _joint_columns(robot: Robot) -> list[str]:
    """Return the column of each arm joint: its name, or `joint.NAME` if another column has it."""
    others = {"time", *_BASE, *columns("ee_pose")}
    names = (joint.name for joint in robot.arm)
    return [f"joint.{name}" if name in others else name for name in names]


def _check_plan(file: Path, plan: Plan) -> None:
    """Raise KinfeasError on the first row that the robot cannot carry out."""
    robot, states = plan.robot, np.hstack([plan.base, plan.joint_positions])
    lower, upper = robot.joint_limits
    arm, within = plan.joint_positions, np.abs(states) <= FARTHEST
    within[:, 3:] &= (lower - _ROUNDING <= arm) & (arm <= upper + _ROUNDING)
    x, y, *others = np.diff(states, axis=0).T
    planar, middle = np.hypot(x, y), states[:-1, 2] + others[0] / 2.0
    moved = np.column_stack([planar, planar, *np.abs(others)])
    drive = [robot.base.max_velocity, robot.base.max_velocity, robot.base.max_rotation]
    largest = np.array([*drive, *robot.max_joint_velocity]) * np.diff(plan.time)[:, np.newaxis]
    slow, ahead = np.ones_like(within), np.ones_like(within)
    slow[1:] = moved <= 1.001 * largest + _ROUNDING
    if robot.base.drive == "differential":
        aside = np.abs(np.cos(middle) * y - np.sin(middle) * x)
        ahead[1:, 0] = aside <= _ASIDE + _SLIPPING * planar
    names = (*_BASE, *plan.joint_names)
    rules = "is beyond its limits", "exceeds the maximum velocity", "moves the base sideways"
    for holds, rule in zip((within, slow, ahead), rules, strict=True):
        if not holds.all():
            row, column = np.argwhere(~holds)[0].tolist()
            raise KinfeasError(f"{file}, row {row + 1}: {names[column]!r} {rule}")
    tolerance = 0.0 if robot.pose_tolerance is None else robot.pose_tolerance.position
    far = distance(plan.reached, plan.ee_pose)[0] > _AT_START + tolerance
    if far.any():
        row = int(far.argmax()) + 1
        raise KinfeasError(f"{file}, row {row}: base and arm do not reach the EE pose")


def _state(robot: Robot, start: Sequence[float], joints: Sequence[float] | None) -> State:
    if joints is None:
        return base_pose(start, "start"), robot.home["home"]
    arm = np.array(checked(tuple[float, ...], joints, "joints"))
    if len(arm) != len(robot.arm):
        raise KinfeasError(f"'joints' must be {len(robot.arm)} numbers, not {len(arm)}")
    lower, upper = robot.joint_limits
    beyond = (arm < lower - _ROUNDING) | (arm > upper + _ROUNDING)
    if beyond.any():
        k = int(beyond.argmax())
        limits = f"[{lower[k]:.4g}, {upper[k]:.4g}]"
        raise KinfeasError(f"'joints': {robot.arm[k].name} must be in {limits}, not {arm[k]:g}")
    return base_pose(start, "start"), arm


def _from_start(solver: IkSolver, base: Array, joints: Array, ee: Array) -> Array:
    """Return EE poses with the robot's EE pose before them, unless it is at the first already."""
    now = compose(base, forward(solver.chain, joints[np.newaxis]))
    metres, radians = distance(now, ee[:1])
    at_start = metres[0] <= _AT_START and radians[0] <= _TURNED
    return ee if at_start else np.concatenate([now, ee])


def _divided(ee: Array, step: float, base: Base) -> tuple[Array, float]:
    """Return EE poses at most `HORIZON` seconds apart, and their time step in seconds.

    Where the EE would be faster than the base, more poses are inserted, which slow it down.
    """
    metres, radians = distance(ee[:-1], ee[1:])
    speed = np.maximum(metres / base.max_velocity, radians / base.max_rotation) / step
    parts = math.ceil(step / HORIZON - _ROUNDING)
    pieces = parts * np.ceil(np.where(speed > 1.0 + _ROUNDING, speed / _SLOWER, 1.0))
    if pieces.sum() * step / parts >= LONGEST:
        raise KinfeasError(f"'path': the EE motion takes longer than {LONGEST:g} s")
    index, samples = np.append(0.0, np.cumsum(pieces)), np.arange(float(len(ee)))
    times = np.interp(np.arange(index[-1] + 1.0), index, samples)
    return interpolated(times, samples, ee), step / parts


def _motion(
    path: Name, target: ArrayLike | None, start: Sequence[float] | None, settings: Settings | None
) -> tuple[MotionSpec, Array]:
    """Return the motion of a file with its EE poses, (k, 7), or of a generator with its target."""
    if isinstance(path, Path) or Path(path.rpartition(":")[2]).suffix:  # not module.name:Class
        if target is not None:
            raise KinfeasError("'target' is for generators, not for files")
        poses, parameters = read_waypoints(Path(path))[0], {"file": str(path), "frame": "world"}
        if fixed := parameters.keys() & nested(settings).keys():
            raise KinfeasError(f"{min(fixed)!r} is no setting of a plan")
        return MotionSpec("waypoints", {**parameters, **nested(settings)}), poses
    motion = MotionSpec(str(path), nested(settings))
    if target is None or start is None:
        build_subgoals([Subgoal(motion)])  # raises an error for unknown generators
        missing = "start" if target is not None else "target"
        raise KinfeasError(f"motion generator {str(path)!r} needs {missing!r}")
    return motion, ee_poses(target, "target")[:1]


def _rolled_out(
    solver: IkSolver, motion: MotionSpec, poses: Array, state: State | None, solids: Solids | None
) -> Array:
    """Return the EE poses of a motion every `HORIZON` seconds, shape (k, 7)."""
    if state is None:  # place the robot, its arm at home, with the EE at the first pose
        home = solver.robot.home["home"]
        ee = forward(solver.chain, home[np.newaxis])[0]
        state = compose(poses[0], relative(IDENTITY, ee)), home
    start = Start(state[0][np.newaxis], state[1][np.newaxis], poses[np.newaxis, -1:], solids)
    sequence = begin_motions(
        solver, build_subgoals([Subgoal(motion)]), start, [np.random.default_rng(0)]
    )
    if solids is not None:
        sequence.avoid(solids, None, (start.base_pose, start.joint_positions))
    return sequence.to_the_end(np.arange(1), to_rest=True)[0]


def _header(seconds: float, frame: str) -> dict[str, object]:
    return {"stamp": _stamp(seconds), "frame_id": frame}


def _stamp(seconds: float) -> dict[str, int]:
    nanoseconds = round(1e9 * seconds)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
