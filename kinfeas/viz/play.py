"""A live page: simulated robots follow a target that is dragged with the mouse."""

import inspect
import queue
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinfeas.config import registry
from kinfeas.core import spatial
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe
from kinfeas.core.files import writing
from kinfeas.core.spatial import Array
from kinfeas.io.demonstrations import Demonstration, write_demonstration
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import SHIPPED, read_scene
from kinfeas.viz.pages import Bodies, ShownRobot, draw_floor
from kinfeas.viz.shapes import robot_solids, scene_solids
from kinfeas.viz.style import ARM, EE, GOAL

if TYPE_CHECKING:
    from kinfeas.viz.live import Episode

_STEPS_PER_FRAME = 2
_FRAMES_PER_PLOT = 6
_BESIDE = np.array([0.0, 1.6, 0.0])  # m, where the second robot is drawn
_HELP = "**Drag the arrows and rings at the gripper**: base and arm follow."
_NO_PLOTS = "<style>@media (max-width: 36em) {.uplot-container {display: none}}</style>"
"""Hides plots where the controls lie below the picture, as on phones."""

NONE = "none"
"""Value of `second_policy` and `scene` for none."""


@dataclass(frozen=True)
class Choice:
    """Settings of the page."""

    robot: str  # robot by name or path
    policy: str = "pretrained"  # policy by name or path
    second_policy: str = NONE  # policy of a second robot with the same target, or `none`
    generator: str = "servo"  # motion generator
    filters: tuple[str, ...] = ("time_scaling",)  # names of the command filters, in order
    backend: str = "analytic"  # backend by name
    scene: str = "room"  # scene by name or path, or `none`


class PlayPage:
    """The page and its robots; callbacks of the browser run between two frames.

    Attributes:
        server: Server of viser.
        handle: Handle of the target.
        frames: Number of frames that were sent.
    """

    def __init__(self, server: Any, choice: Choice, folder: Path) -> None:
        """Draw robot and scene of a choice, at rest; `start` builds their simulation.

        Demonstrations are written to `folder`.
        """
        self.server, self.choice, self._folder = server, choice, folder
        self._tasks: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._episodes: list[Episode] = []
        self._shown: list[ShownRobot] = []
        self._plots: list[Any] = []
        self._samples: list[tuple[float, Array, Array]] | None = None
        self._recording = False
        self._held, self._paused, self.frames = False, False, 0
        server.gui.configure_theme(
            control_layout="floating", show_logo=False, show_share_button=False
        )
        server.initial_camera.position = np.array([1.9, -2.1, 1.9])
        server.initial_camera.look_at = np.array([0.6, 0.3, 0.7])  # left of the controls
        server.on_client_connect(_make_room)
        self._robot = load_robot(choice.robot)
        self._scene = self._draw_scene(choice.scene)
        home = robot_solids(self._robot, spatial.IDENTITY, self._robot.home["home"])
        self._first = Bodies(server, "/first", home)
        self.handle = server.scene.add_transform_controls("/target", scale=0.35, depth_test=False)
        self.handle.visible = False

        @self.handle.on_update
        async def _(event: Any) -> None:
            self._held = event.phase != "end"

        self._add_controls()

    @property
    def target(self) -> Array:
        """World pose of the handle, shape (7,)."""
        return np.concatenate([self.handle.position, np.roll(self.handle.wxyz, -1)])

    def start(self) -> None:
        """Build the episodes of the choice; raise KinfeasError if that is impossible."""
        self._build(self.choice)
        self._first.remove()

    def run(self, seconds: float = np.inf) -> None:
        """Run in real time; slower where the computer is too slow."""
        from kinfeas.viz.live import DT

        ends, due = time.monotonic() + seconds, time.monotonic()
        while (now := time.monotonic()) < ends:
            with suppress(queue.Empty):
                while True:
                    self._tasks.get_nowait()()
            self.frame()
            due = max(due + _STEPS_PER_FRAME * DT, now)
            time.sleep(max(0.0, due - time.monotonic()))

    def frame(self) -> None:
        """Advance all episodes by one frame and draw them."""
        if self._paused or not self._episodes:
            return
        target, held = self.target, self._held
        for _ in range(_STEPS_PER_FRAME):
            for episode, drawn in zip(self._episodes, self._shown, strict=True):
                episode.step(target, held=held)
                drawn.note()
            self._sample()
        with self.server.atomic():
            for drawn in self._shown:
                drawn.draw(target)
            if self.frames % _FRAMES_PER_PLOT == 0:
                self._draw_plots()
        self.frames += 1

    def close(self) -> None:
        """Save the recording and end all episodes; raise KinfeasError if it cannot be saved."""
        for episode in self._episodes:
            episode.close()
        self._episodes = []
        if self._samples:
            self._write(self._samples)

    def record(self) -> None:
        """Begin a recording, or end and save it."""
        if self._samples is not None:
            self.save()
            return
        self._samples, self._recording = [], True
        self._record.label, self._message.content = "Stop and save", "Recording."

    def save(self) -> None:
        """End the recording and write the demonstration; if that fails, keep the recording."""
        if self._samples is None:
            return
        self._recording = False
        try:
            saved = self._write(self._samples)
        except KinfeasError as error:
            self._record.label = "Save again"
            self._message.content = f"**The recording is not saved yet**: {error}"
        else:
            self._samples, self._record.label, self._message.content = None, "Record", saved

    def _write(self, samples: list[tuple[float, Array, Array]]) -> str:
        if len(samples) < 2:
            return "Nothing moved, so nothing is saved."
        with writing(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        numbers = (self._folder / f"{number:03}.csv" for number in count(1))
        path = next(path for path in numbers if not path.exists())
        time, ee, base = map(np.array, zip(*samples, strict=True))  # ee: poses of the tool tip
        object_frame = np.repeat(ee[-1:], len(ee), axis=0)  # its last pose
        write_demonstration(Demonstration(time, ee, base, object_frame), path)
        return f"Saved {path}."

    def _sample(self) -> None:
        from kinfeas.control.execution import tool_pose

        if self._recording and self._samples is not None:
            episode = self._episodes[0]
            tool = spatial.compose(episode.ee_pose, tool_pose(self._robot))
            self._samples.append((episode.seconds, tool, episode.base_pose.copy()))

    def _add_controls(self) -> None:
        gui, choice = self.server.gui, self.choice
        gui.add_html(_NO_PLOTS)
        gui.add_markdown(_HELP)
        self._status, self._message = gui.add_markdown("Loading."), gui.add_markdown("")
        pause = gui.add_button("Pause")
        reset = gui.add_button("Reset")
        self._record = gui.add_button("Record")

        def toggle() -> None:
            self._paused = not self._paused
            pause.label = "Continue" if self._paused else "Pause"

        for button, task in ((pause, toggle), (reset, self._reset), (self._record, self.record)):
            button.on_click(lambda _, task=task: self._tasks.put(task))
        policies = ["pretrained", *registry.names("kinfeas.policies")]
        options = {
            "robot": registry.names("kinfeas.robots"),
            "policy": policies,
            "second_policy": [NONE, *policies],
            "generator": _generators(),
            "backend": ["analytic", "pybullet", "mujoco"],
            "scene": [NONE, *SHIPPED],
        }
        inputs, boxes = {}, {}
        with gui.add_folder("Settings", expand_by_default=False):
            for key, values in options.items():
                value = getattr(choice, key)
                names = list(dict.fromkeys([*values, value]))
                label = key.replace("_", " ")
                inputs[key] = gui.add_dropdown(label, names, initial_value=value)
            self._beside = gui.add_checkbox("side by side", True)
            gui.add_markdown("Command filters:")
            for name in dict.fromkeys([*choice.filters, *registry.names("kinfeas.filters")]):
                boxes[name] = gui.add_checkbox(name, name in choice.filters)

        def change() -> None:
            filters = tuple(sorted((n for n, box in boxes.items() if box.value), key=_order))
            selected = {key: control.value for key, control in inputs.items()}
            try:
                self._build(Choice(**selected, filters=filters))
            except (KinfeasError, ImportError) as error:
                self._message.content = f"**{error}**"
            except PLUGIN_ERRORS as error:
                self._message.content = f"**{describe(error)}**"

        self._beside.on_update(lambda _: self._tasks.put(self._arrange))
        for control in (*inputs.values(), *boxes.values()):
            control.on_update(lambda _: self._tasks.put(change))

    def _build(self, choice: Choice) -> None:
        """Save the recording and replace the episodes; if they cannot be built, keep the old."""
        from kinfeas.viz.live import Episode  # slow: after the first picture

        self._message.content = ""
        if self._episodes and choice == self.choice:
            return
        fresh: list[Episode] = []
        robot = load_robot(choice.robot)
        scene = None if choice.scene == NONE else read_scene(choice.scene)
        with ExitStack() as opened:
            for policy in (choice.policy, choice.second_policy):
                if policy != NONE:
                    episode = Episode(
                        robot, policy, scene, generator=choice.generator,
                        filters=choice.filters, backend=choice.backend,
                    )  # fmt: skip
                    fresh.append(episode)
                    opened.callback(episode.close)
            opened.pop_all()
        self.save()
        for episode in self._episodes:
            episode.close()
        if choice.scene != self.choice.scene:
            for drawn in self._scene:
                drawn.remove()
            self._scene = self._draw_scene(choice.scene)
        self._episodes, self.choice, self._robot = fresh, choice, robot
        self.server.rename(f"kinfeas: {robot.name}")
        self._show()

    def _reset(self) -> None:
        self.save()
        for episode in self._episodes:
            episode.restart()
        self._show()

    def _show(self) -> None:
        for number in range(2):
            with suppress(KeyError):
                self.server.scene.remove_by_name(f"/robots/{number}")
        policies = (self.choice.policy, self.choice.second_policy)
        self._shown = [
            ShownRobot(self.server, f"/robots/{number}", self._robot, policy, episode, number > 0)
            for number, (policy, episode) in enumerate(zip(policies, self._episodes, strict=False))
        ]
        self._arrange()
        pose = self._episodes[0].ee_pose
        self.handle.position, self.handle.wxyz = pose[:3], np.roll(pose[3:], 1)
        self.handle.visible = True
        for drawn in self._shown:
            drawn.draw(pose)
        self._add_plots()

    def _arrange(self) -> None:
        for drawn in self._shown[1:]:
            drawn.root.position = _BESIDE * self._beside.value
        self._beside.visible = len(self._shown) > 1

    def _draw_scene(self, name: str) -> list[Any]:
        scene = None if name == NONE else read_scene(name)
        size = (10.0, 10.0) if scene is None else scene.size
        floor = draw_floor(self.server, size, 0.5)
        if scene is None:
            return [floor]
        return [floor, Bodies(self.server, "/scene", scene_solids(scene))]

    def _add_plots(self) -> None:
        for plot in self._plots:
            plot.remove()
        policies = (self.choice.policy, self.choice.second_policy)
        deviations = zip(policies, (EE, GOAL), self._shown, strict=False)
        joints = [(joint.name, ARM) for joint in self._robot.arm]
        self._plots = [
            self._add_plot(
                "Deviation, mm", 1.0, [(name, colour) for name, colour, _ in deviations]
            ),
            self._add_plot("Joint speeds, % of limits", 10.0, joints),
        ]
        self._draw_plots()

    def _add_plot(self, title: str, top: float, lines: list[tuple[str, str]]) -> Any:
        """Add a plot from 0 to at least `top`, since uPlot labels all ticks of tiny values 0."""
        hue = len(lines) if len(lines) > 2 else 0
        series = [
            {"label": name, "stroke": f"hsl({360 * n // hue}, 60%, 45%)" if hue else colour}
            for n, (name, colour) in enumerate(lines)
        ]
        zero: dict[str, float] = {"soft": 0.0, "mode": 1, "pad": 0.1}
        limits = {"range": {"min": zero, "max": zero | {"soft": top}}}
        return self.server.gui.add_uplot(
            (np.zeros(1), *np.zeros((len(lines), 1))), ({}, *series), title=title, aspect=2.0,
            scales={"x": {"time": False}, "y": limits}, legend={"show": not hue},
            padding=(12, 8, 0, 0),
        )  # fmt: skip

    def _draw_plots(self) -> None:
        first = self._shown[0]
        for drawn in self._shown:
            drawn.draw_paths()
        times = np.array(first.times)
        self._plots[0].data = (times, *(np.array(drawn.deviations) for drawn in self._shown))
        self._plots[1].data = (times, *np.ascontiguousarray(np.array(first.speeds).T))
        status = "\n\n".join(drawn.report() for drawn in self._shown)
        if status != self._status.content:
            self._status.content = status


def _make_room(client: Any) -> None:
    """Move the view above the controls, which cover the lowest quarter of a phone."""
    if client.camera.aspect < 1.0:
        with client.atomic():
            client.camera.position = np.array([2.6, -2.9, 2.2])
            client.camera.look_at = np.array([0.2, 0.0, -0.7])


def _generators() -> list[str]:
    """Return the names of the motion generators that need no parameters."""
    group, names = "kinfeas.motion_generators", []
    for name in registry.names(group):
        with suppress(KinfeasError, TypeError):  # broken plugins, and required parameters
            inspect.signature(registry.load(group, name)).bind()
            names.append(name)
    return names


def _order(name: str) -> tuple[bool, bool, str]:
    """Return a key that sorts feasibility before time scaling and both behind other filters."""
    return name == "time_scaling", name == "feasibility", name
