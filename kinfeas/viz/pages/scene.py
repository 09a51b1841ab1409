"""A scene to turn about in a browser, by viser: a page that stands alone, or one with sliders."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinfeas.robots.urdf import Joint
from kinfeas.scenes.objects import free_joints
from kinfeas.scenes.scene import Scene
from kinfeas.viz.pages.viser_server import rgb, start_server, stop_server, wxyz
from kinfeas.viz.pictures.scene import painted_shapes

_FRAMES, _RATE = 90, 30.0  # of the film in which everything opens and closes, and frames per second
_TURN = 3.0  # rad, how far a joint without limits is turned
_CAMERA = (5.0, -8.0, 6.0)  # m, for a room of 10 m

Positions = dict[str, dict[str, float]]


class ScenePage:
    """A scene on a viser server, whose doors and drawers can be moved.

    Args:
        scene: What is shown.
        port: Where on this machine the server listens; 0 is any free port.

    Raises:
        KinfeasError: If viser is not installed.
    """

    def __init__(self, scene: Scene, port: int = 0) -> None:
        self._scene, self._server = scene, start_server(scene.name, port)
        self._server.initial_camera.position = np.array(_CAMERA) * max(scene.size) / 10.0
        self._server.initial_camera.look_at = np.zeros(3)
        self._server.scene.add_grid(
            "/floor", *scene.size, cell_size=1.0, plane_color=(245, 246, 248), plane_opacity=1
        )
        self._solids = draw_scene(self._server, scene)

    @property
    def address(self) -> str:
        """Return what to open in a browser."""
        return f"http://127.0.0.1:{self._server.get_port()}"

    def html(self) -> str:
        """Return a page that stands alone, in which all that has a joint opens and closes."""
        film = self._server.get_scene_serializer()
        for frame in range(_FRAMES if self._joints() else 0):
            self.move(self._opened(0.5 - 0.5 * np.cos(2.0 * np.pi * frame / _FRAMES)))
            film.insert_sleep(1.0 / _RATE)
        html: str = film.as_html()
        return html

    def add_sliders(self) -> None:
        """Give the page a slider for each joint."""
        sliders: dict[tuple[str, str], Any] = {}

        def follow(_: object) -> None:
            positions: Positions = {}
            for (name, joint), slider in sliders.items():
                positions.setdefault(name, {})[joint] = slider.value
            self.move(positions)

        for name, joint in self._joints():
            low, high = _range(joint)
            at = self._scene.objects[name].joint_positions[joint.name]
            slider = self._server.gui.add_slider(
                f"{name}: {joint.name}", low, high, (high - low) / 200.0, at
            )
            slider.on_update(follow)
            sliders[name, joint.name] = slider

    def move(self, positions: Mapping[str, Mapping[str, float]]) -> None:
        """Show objects with their joints at `positions`, rad or m, by object and joint."""
        moved = painted_shapes(self._scene.with_joints(positions))
        for solid, (name, shape, _) in zip(self._solids, moved, strict=True):
            if name in positions:
                solid.position, solid.wxyz = shape.pose[:3], wxyz(shape.pose)

    def close(self) -> None:
        """Stop the server."""
        stop_server(self._server)

    def _joints(self) -> list[tuple[str, Joint]]:
        return [
            (name, joint)
            for name, one in self._scene.objects.items()
            for joint in free_joints(one.urdf).values()
        ]

    def _opened(self, share: float) -> Positions:
        """Return the joints at `share` of the way from where they stand to their upper limit."""
        positions: Positions = {}
        for name, joint in self._joints():
            at = self._scene.objects[name].joint_positions[joint.name]
            way = _range(joint)[1] - at
            positions.setdefault(name, {})[joint.name] = at + share * way
        return positions


def draw_scene(server: Any, scene: Scene) -> list[Any]:
    """Draw all shapes of a scene; return them in the order of `painted_shapes`."""
    show = server.scene
    kinds: dict[str, tuple[Any, tuple[str, ...]]] = {
        "box": (show.add_box, ()),
        "cylinder": (show.add_cylinder, ("radius", "height")),
        "sphere": (show.add_icosphere, ("radius",)),
    }
    solids = []
    for number, (name, shape, colour) in enumerate(painted_shapes(scene)):
        placed = {"position": shape.pose[:3], "wxyz": wxyz(shape.pose)}
        make, measures = kinds[shape.kind]
        sizes = (
            dict(zip(measures, shape.size, strict=True)) if measures else {"dimensions": shape.size}
        )
        solids.append(make(f"/{name}/{number}", color=rgb(colour), **sizes, **placed))
    return solids


def _range(joint: Joint) -> tuple[float, float]:
    return max(joint.lower, -_TURN), min(joint.upper, _TURN)
