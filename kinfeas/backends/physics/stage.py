"""A task in a physics world: its episodes, with the objects placed for each of them."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, rotation
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.scenes.scene import Scene
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import StreamTask, Task

if TYPE_CHECKING:  # it imports this module
    from kinfeas.backends.physics.backend import PhysicsBackend

_DRAWS = 1000  # starts that are drawn before an error
_SETTLE_SECONDS = 2.0  # in which objects that were put down come to rest
_REST = 0.05  # m/s, largest speed at rest
_UPRIGHT = float(np.cos(np.pi / 4.0))  # smallest vertical part of an upright unit vector


class Stage:
    """A task whose episodes also place robot and objects in a physics backend.

    The furniture is among the solids of each episode, so that plans, IK and scans include it. A
    start in which the robot touches something is drawn again, with the objects and goals of the
    first draw, so that the goals equal those without physics.

    Attributes:
        task: Task that draws the episodes.
        name: Its name.
        subgoals: Its sub-goals.
        scene: Scene before an episode moves objects; None for a floor only.
        success: Condition on objects of the scene; None without one.
        backend: Backend that simulates them.
    """

    def __init__(self, task: Task, backend: "PhysicsBackend") -> None:
        """Connect a task to a backend with the scene of the task, or without a scene."""
        self.task, self.name, self.subgoals = task, task.name, task.subgoals
        self.backend, self.scene = backend, backend.scene
        self._placed: dict[int, Scene] = {}
        self._chain = task if isinstance(task, ChainTask) else None
        self._task_scene = self._chain.scene if self._chain and self.scene else None
        self.success = self._task_scene.success if self._task_scene else None
        backend.furniture = 0
        if self._chain and self.scene:
            backend.furniture = self._chain.solids_of(self.scene).places
        if self._task_scene and (grasped := self._task_scene.grasped_object):
            if backend.robot.gripper is None:
                raise KinfeasError(
                    f"task {self.name!r} grasps an object, and robot {backend.robot.name!r} has no "
                    "gripper: its YAML lacks 'gripper'; evaluate --no-objects runs the motion alone"
                )
            backend.handle(grasped.object, grasped.link, rigid=not grasped.revolute)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode; place the first robot and its objects."""
        return self.sample_in(0, solver, rng)

    def sample_in(self, row: int, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode; place robot and objects of a row."""
        first, scene = self.task.sample(solver, rng), self.scene
        if scene is not None:
            if self._chain and (poses := self._chain.object_poses(first.target_poses)):
                scene = scene.with_poses(poses)
                scene.check_layout(f"task {self.name!r}")
            self._placed[row] = scene
            if self._chain and first.solids is None:
                first = replace(first, solids=self._chain.solids_of(scene))
        start = first
        for _ in range(_DRAWS):
            if self.backend.place(row, scene, start.base_pose, start.joint_positions):
                return start
            if self._chain:
                start = self._chain.toward(first.target_poses, solver, rng, first.solids)
            else:
                start = self.task.sample(solver, rng)
        raise KinfeasError(
            f"task {self.name!r}: the robot touches floor or furniture in all of {_DRAWS} starts"
        )

    def drawn(self, start: Start) -> tuple[str, dict[str, Array], Solids | None]:
        """Return name of the scene, poses of moved objects and other solids, as in `StagedTask`."""
        solids = start.solids and start.solids.beyond(self.backend.furniture)
        beside = solids if solids and solids.places else None
        if self._task_scene is None:
            return "", {}, beside
        objects, moves = self._scene_of(0).objects, self._task_scene.moves
        return self._task_scene.name, {name: objects[name].pose for name in moves}, beside

    def task_done(
        self, row: int, joint_positions: Array, dt: float, *, reached: bool
    ) -> bool | None:
        """Return whether the episode of a row met the success condition; None without one.

        First the robot holds still until objects are at rest; arguments as in `StagedTask`.
        """
        if (success := self.success) is None:
            return None
        self.backend.hold(row, joint_positions[row], dt, round(_SETTLE_SECONDS / dt))
        return False if success.reached and not reached else self.done(row)

    def done(self, row: int = 0) -> bool | None:
        """Return whether the objects of a row meet the success condition; None without one."""
        if (success := self.success) is None:
            return None
        if success.joint is not None:
            position = self.backend.object_joint(row, success.object, success.joint)
            limit = success.threshold
            return position < limit if limit < 0.0 else position > limit
        # An object in the hand was not put down.
        held = self.backend.holds(row, success.object)
        return not held and self.stands(row, success.object, str(success.parent))

    def stands(self, row: int, name: str, on: str) -> bool:
        """Return whether an object is at rest on another one, and upright as in the scene."""
        pose, speed = self.backend.object_motion(row, name)
        upright = rotation(self._scene_of(row).objects[name].pose).as_matrix()
        tilt = float((rotation(pose).as_matrix() @ upright.T)[2, 2])
        supported = self.backend.is_on(row, name, on, _UPRIGHT)
        return speed <= _REST and supported and tilt >= _UPRIGHT

    def _scene_of(self, row: int) -> Scene:
        assert self.scene is not None
        return self._placed.get(row, self.scene)


class StreamStage(Stage):
    """A task whose targets move, in a physics backend; attributes as in `StreamTask`."""

    def __init__(self, task: Task, stream: StreamTask, backend: "PhysicsBackend") -> None:
        """Connect a task, which is also `stream`, to a backend."""
        super().__init__(task, backend)
        self.seconds, self.target_stream = stream.seconds, stream.target_stream
