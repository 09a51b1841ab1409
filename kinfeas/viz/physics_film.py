"""Films of an episode in a physics world: everything visible, moved as the engine moved it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from matplotlib.colors import to_hex

from kinfeas.backends.physics.backend import PhysicsBackend
from kinfeas.backends.physics.stage import Stage
from kinfeas.backends.physics.visuals import LinkName, VisualShape, visual_shapes
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array, compose
from kinfeas.envs.world import World
from kinfeas.evaluation.paper import TITLES
from kinfeas.evaluation.recording import record_episodes
from kinfeas.robots.urdf import Shape
from kinfeas.viz.episodes import SolidsFilm
from kinfeas.viz.shapes import Solid

_WALL = 4.0  # m; longer boxes hide the room


@dataclass(frozen=True, eq=False)
class PhysicsFilm(SolidsFilm):
    """An episode in a physics world.

    Attributes:
        shapes: What is visible.
        links: Its links.
        moments: World poses of the links at each moment, shape (links, 7).
    """

    shapes: Sequence[VisualShape]
    links: Sequence[LinkName]
    moments: Sequence[Array]

    def solids(self, moment: int) -> list[Solid]:
        """Return what is visible at a moment."""
        return solids(self.shapes, self.links, self.moments[moment])


def make_film(world: World, policy: Policy, episode: int) -> PhysicsFilm:
    """Run one episode of a physics world and return its film, seen from beside the path."""
    stage, backend = world.task, world.backend
    if not isinstance(stage, Stage) or not isinstance(backend, PhysicsBackend):
        raise TypeError(f"a world with physics is needed, not {world.config.backend}")
    stage.sample(world.solver, world.rng(episode))
    shapes, links = visible(backend)
    moments = [backend.link_poses(0, links)]
    (recording,) = record_episodes(
        world, policy, 1, episode, lambda *_: moments.append(backend.link_poses(0, links))
    )
    if not stage.has_success_condition:
        recording = replace(recording, task_done=None)
    if recording.solids is not None:  # furniture is visible already
        recording = replace(recording, solids=recording.solids.beyond(backend.furniture))
    title = f"{TITLES.get(world.robot.name, world.robot.name)}, {world.task.name}"
    return PhysicsFilm(recording, title, shapes, links, moments)


def visible(backend: PhysicsBackend) -> tuple[list[VisualShape], list[LinkName]]:
    """Return what is visible in a world without its walls, and its links."""
    shapes = [
        one
        for one in visual_shapes(backend.robot, backend.scene)
        if one.shape.kind != "box" or max(one.shape.size) <= _WALL
    ]
    return shapes, list(dict.fromkeys(one.link for one in shapes))


def solids(shapes: Sequence[VisualShape], links: Sequence[LinkName], poses: Array) -> list[Solid]:
    """Return shapes in the world for the poses of their links, shape (links, 7)."""
    at = dict(zip(links, poses, strict=True))

    def placed(one: VisualShape) -> Shape:
        return replace(one.shape, pose=compose(at[one.link], one.shape.pose))

    return [Solid(placed(one), to_hex(one.colour)) for one in shapes]
