"""The stage of a task: its episodes, with the furniture where each of them wants it."""

import numpy as np

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.task_check import check_task
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.scenes.scene import Scene, read_scene
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.checks import unchecked
from kinfeas.tasks.task import Subgoal, Task

_DRAWS = 1000
_SETTLE_SECONDS = 2.0  # in which what was put down comes to rest


class Stage:
    """A task whose episodes set the PyBullet world up when they are drawn.

    It takes the task's place. Where the robot would touch something, it begins elsewhere: that is
    drawn again, and the furniture stays where the first draw has it, as without a world.

    Attributes:
        task: Draws the episodes.
        scene: What stands there, before an episode moves it; None for a floor and nothing else.
        backend: The world.
    """

    def __init__(self, task: Task, backend: PyBulletBackend) -> None:
        """Connect a task to a world that was built with the task's scene, or without any.

        Raises:
            KinfeasError: If the task names what is not there, or takes hold of what cannot move or
                without a gripper.
        """
        self.task, self.backend = task, backend
        furniture = backend.sims[0].furniture
        self.scene = furniture.scene if furniture else None
        self._chain = _chain(task)
        self._known = self._chain.scene if self._chain and self.scene else None
        if self._known and self.scene:
            check_task(self.name, self._known, self.scene, backend.robot)
            if grasped_object := self._known.grasped_object:
                backend.handle(
                    grasped_object.object, grasped_object.link, rigid=not grasped_object.revolute
                )

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.task.name

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """Sub-goals of the task."""
        return self.task.subgoals

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, and put the first robot and its furniture where it begins."""
        return self.sample_in(0, solver, rng)

    def sample_in(self, row: int, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, and put robot and furniture of a row where it begins.

        Raises:
            KinfeasError: If no draw is free of collisions, or objects are drawn into each other.
        """
        first, simulation = self.task.sample(solver, rng), self.backend.simulation(row)
        if self.scene is not None and simulation.furniture is not None:
            simulation.furniture.furnish(self._moved(self.scene, first))
        for number in range(_DRAWS):
            start = self._again(first, solver, rng) if number else first
            simulation.reset(start.base_pose, start.joint_positions)
            if simulation.free():
                return start
        raise KinfeasError(
            f"task {self.name!r}: the robot touches floor or furniture in all of {_DRAWS} starts"
        )

    def drawn(self) -> tuple[str, dict[str, Array]]:
        """Return the name of the scene, and where the last episode put objects; or nothing."""
        furniture = self.backend.sims[0].furniture
        if self._known is None or furniture is None:
            return "", {}
        objects = furniture.scene.objects
        return self._known.name, {name: objects[name].pose for name in self._known.moves}

    def settle(self, joint_positions: Array, dt: float, row: int = 0) -> None:
        """Let the robot of a row stand still while objects come to rest; joints of all, (n, j)."""
        for _ in range(round(_SETTLE_SECONDS / dt) if self.judges else 0):
            self.backend.sims[row].step(np.zeros(6), joint_positions[row], dt)

    @property
    def judges(self) -> bool:
        """Whether the task wants anything of objects that are there."""
        return self._known is not None

    def done(self, row: int = 0) -> bool | None:
        """Return whether the objects of a row are now as the task wants them.

        None if it wants nothing.
        """
        simulation = self.backend.sims[row]
        furniture, grasp = simulation.furniture, simulation.grasp
        if self._known is None or furniture is None:
            return None
        done = self._known.success
        if done.joint is not None:
            position = furniture.joint_position(done.object, done.joint)
            return position < done.threshold if done.threshold < 0.0 else position > done.threshold
        # What the hand has not let go of has not been put down.
        held = grasp.held if grasp else None
        if held is not None and held[0] == furniture.bodies[done.object]:
            return False
        return furniture.stands(done.object, str(done.parent))

    def _again(self, first: Start, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return another start; a task that moves furniture leads to where `first` does."""
        if self._chain:
            return self._chain.toward(first.target_poses, solver, rng)
        return self.task.sample(solver, rng)

    def _moved(self, scene: Scene, start: Start) -> Scene:
        """Return a scene as an episode wants it, after a check that it can be."""
        poses = self._chain.object_poses(start.target_poses) if self._chain else {}
        if not poses:
            return scene
        moved = scene.with_poses(poses)
        moved.check_places(f"task {self.name!r}")
        return moved


def has_scene(task: Task) -> bool:
    """Return whether a task happens in a scene, and not on a floor and nothing else."""
    chain = _chain(task)
    return chain is not None and chain.scene is not None


def task_scene(task: Task) -> Scene | None:
    """Return the scene that a task happens in; None for a floor and nothing else.

    Raises:
        KinfeasError: If there is no such scene, or it is broken.
    """
    chain = _chain(task)
    if chain is not None and chain.scene is not None:
        return read_scene(chain.scene.name)
    return None


def _chain(task: Task) -> ChainTask | None:
    """Return a task as what moves furniture, if it does."""
    known = unchecked(task)
    return known if isinstance(known, ChainTask) else None
