"""Logs from bags of ROS 1 and ROS 2, read by rosbags; no ROS installation is needed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from pathlib import Path
from struct import error as StructError  # noqa: N812 - an exception
from typing import Any

import numpy as np

from kinfeas.core.errors import KinfeasError, describe
from kinfeas.core.extras import require
from kinfeas.core.spatial import Array, interpolated_columns
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.identify.log import Log, Series, check_clock, make_log
from kinfeas.sim2real.link import BaseReading, JointPath
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.topics import Topics, read_topics

_HELD = 0.5  # s for which a velocity command holds at most: drivers stop without newer ones
_CLOCKS = 1.0  # s by which stamps precede the recording at most, if both are of the same clock
_PERIODS = (0.005, 0.1)  # s, shortest and longest control period


def read_bag(path: Path, robot: Robot) -> Log:
    """Return the log in a bag, with the topics of the robot.

    Velocity commands and trajectories are dated by their recording, measurements by their stamps
    if these are of the same clock.

    Raises:
        KinfeasError: If rosbags is not installed, or the bag is broken, lacks a topic, or has
            messages out of order, a clock that was set, or numbers that are not finite.
    """
    require("rosbags")
    from apsw import Error as ApswError
    from rosbags import rosbag1, rosbag2
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise KinfeasError(f"{path}: no such file or folder")
    folder = path.parent if path.suffix == ".db3" else path
    if folder.is_dir() and not (folder / "metadata.yaml").exists():
        raise KinfeasError(f"{folder}: no bag, since there is no metadata.yaml in the folder")
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            return _Bag(path, robot, read_topics(robot, 2 if reader.is2 else 1)).read(reader)
    except KinfeasError:
        raise
    except (
        AnyReaderError, rosbag1.ReaderError, rosbag2.ReaderError, OSError,
        # What else rosbags raises for broken bytes.
        ApswError, StructError, AssertionError, LookupError, ValueError,
    ) as error:  # fmt: skip
        raise KinfeasError(f"{path}: no bag that can be read: {describe(error)}") from error


@dataclass
class _Stream:
    """Values of a topic, with the times of recording and the stamps, seconds."""

    topic: str
    content: str
    recorded: list[float] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)


class _Bag:
    def __init__(self, path: Path, robot: Robot, topics: Topics) -> None:
        self._path, self._robot, self._topics = path, robot, topics
        base, names = topics.base, topics.joints.names
        self._names = [names.get(joint.name, joint.name) for joint in robot.arm]
        self._twists = _Stream(base.command, "velocity command")
        pose_topic = "/tf" if base.measured_by == "tf" else base.odometry
        self._base = _Stream(pose_topic, "base pose")
        self._joints = _Stream(topics.joints.measured, "position of all arm joints")
        self._positions: dict[str, float] = {}
        self._paths: list[tuple[float, JointPath]] = []
        self._now = 0.0
        self._tree = ros_messages.TfTree(base.world_frame, base.frame, now=lambda: self._now)

    def read(self, reader: Any) -> Log:
        streams = self._twists, self._base, self._joints
        arm = (controller.command for controller in self._topics.joints.controllers)
        takes: dict[str, Callable[[Any], None]] = {
            self._twists.topic: self._take_twist,
            self._joints.topic: self._take_joints,
            **dict.fromkeys(arm, self._take_path),
            self._base.topic: self._take_odometry,
        }
        if self._topics.base.measured_by == "tf":
            takes |= {"/tf": self._take_tf, "/tf_static": partial(self._tree.take, static=True)}
        present = {connection.topic for connection in reader.connections}
        if missing := [stream.topic for stream in streams if stream.topic not in present]:
            raise KinfeasError(f"{self._path}: has no {', '.join(missing)}")
        for name in ("Time", "Duration"):  # as messages of ROS have it
            reader.typestore.types[f"builtin_interfaces/msg/{name}"].to_sec = _to_sec
        connections = [c for c in reader.connections if c.topic in takes]
        for connection, nanoseconds, raw in reader.messages(connections=connections):
            self._now = nanoseconds / 1e9
            takes[connection.topic](reader.deserialize(raw, connection.msgtype))
        for stream in streams:
            if len(stream.values) < 2:
                raise KinfeasError(f"{self._path}: has no {stream.content} in {stream.topic}")
        return self._log()

    def _take_twist(self, message: Any) -> None:
        self._put(self._twists, ros_messages.velocity(message), None)

    def _take_odometry(self, message: Any) -> None:
        self._put_pose(ros_messages.from_odometry(message))

    def _take_tf(self, message: Any) -> None:
        self._tree.take(message)
        reading, stamps = self._tree.reading(), self._base.stamps
        if reading is not None and (not stamps or reading.stamp != stamps[-1]):
            self._put_pose(reading)

    def _take_joints(self, message: Any) -> None:
        if (reading := ros_messages.from_joint_state(message)) is None:
            return
        self._positions.update(reading.positions)
        if any(name in reading.positions for name in self._names) and all(
            name in self._positions for name in self._names
        ):
            values = np.array([self._positions[name] for name in self._names])
            self._put(self._joints, values, reading.stamp)

    def _take_path(self, message: Any) -> None:
        if (path := ros_messages.path(message)) is not None:
            self._paths.append((self._now, path))

    def _put_pose(self, reading: BaseReading) -> None:
        self._put(self._base, np.array([reading.x, reading.y, reading.yaw]), reading.stamp)

    def _put(self, stream: _Stream, values: Array, stamp: float | None) -> None:
        if not np.isfinite(values).all():
            raise KinfeasError(f"{self._path}: a number of {stream.topic} is not finite")
        stamp = stamp or self._now
        if stream.stamps and stamp < stream.stamps[-1]:
            back = stream.stamps[-1] - stamp
            raise KinfeasError(
                f"{self._path}: messages of {stream.topic} are out of order: a stamp goes back by "
                f"{back:.3g} s"
            )
        stream.recorded.append(self._now)
        stream.stamps.append(stamp)
        stream.values.append(values)

    def _log(self) -> Log:
        (base, ages), (joints, _) = _measured(self._base), _measured(self._joints)
        for times, _ in (base, joints):
            check_clock(times - times[0], str(self._path))
        base = base[0], np.stack([*base[1].T[:2], np.unwrap(base[1][:, 2])], axis=1)
        commands = np.array(self._twists.recorded)
        dt = float(np.clip(np.median(np.diff(commands)), *_PERIODS))
        log = make_log(
            str(self._path), self._robot, dt, self._commands(base),
            self._arm_targets(float(commands[0]), joints[1][0]), base, joints, ages,
            end=min(float(commands[-1]) + _HELD, float(base[0][-1]), float(joints[0][-1])),
            arm_seconds=self._arm_seconds(),
        )  # fmt: skip
        for values in (log.base, log.joints):
            self._check_order(values)
        return log

    def _check_order(self, values: Array) -> None:
        """Raise KinfeasError if two motions alternate in values, shape (k, w).

        Readers sort messages by time. If the clock was set back, messages from before and after
        that alternate, so that neighbours are farther apart than every second value.
        """
        next_one, next_but_one = (float(np.sum((values[n:] - values[:-n]) ** 2)) for n in (1, 2))
        if next_one > 2.0 * next_but_one:
            raise KinfeasError(
                f"{self._path}: measurements of two motions alternate: its clock was set back, or "
                "two nodes publish them"
            )

    def _arm_seconds(self) -> float:
        """Return the usual duration of trajectories of one point; 0 without any."""
        ends = [path.times[0] for _, path in self._paths if len(path.times) == 1]
        return float(np.median(ends)) if ends else 0.0

    def _commands(self, base: Series) -> Series:
        """Return the commands in world axes, and zero once none has come for `_HELD` seconds."""
        times, values = np.array(self._twists.recorded), np.array(self._twists.values)
        late = np.flatnonzero(np.diff(times, append=np.inf) > _HELD)
        times = np.insert(times, late + 1, times[late] + _HELD)
        values = np.insert(values, late + 1, 0.0, axis=0)
        heading = np.interp(times, base[0], base[1][:, 2])
        cosine, sine = np.cos(heading), np.sin(heading)
        forward, left, turn = values.T
        x, y = cosine * forward - sine * left, sine * forward + cosine * left
        return times, np.stack([x, y, turn], axis=1)

    def _arm_targets(self, begin: float, start: Array) -> Series:
        """Return the arm's targets over time; a single point of a trajectory is one at once."""
        aim = dict(zip(self._names, start, strict=True))
        times, values, points = [begin], [start.copy()], list[tuple[float, dict[str, float]]]()
        for number, (sent, path) in enumerate(self._paths):
            # Only a trajectory with joints of this one replaces it.
            later = (
                when for when, other in self._paths[number + 1 :]
                if not set(path.joints).isdisjoint(other.joints)
            )  # fmt: skip
            until = next(later, self._now)  # or the end of the recording
            for when, name_positions in _points(path, sent, until, aim):
                aim.update(name_positions)
                points.append((when, name_positions))
        aim = dict(zip(self._names, start, strict=True))
        for when, name_positions in sorted(points, key=itemgetter(0)):
            aim.update(name_positions)
            times.append(max(when, begin))
            values.append(np.array([aim[name] for name in self._names]))
        return np.array(times), np.array(values)


def _points(
    path: JointPath, sent: float, until: float, aim: dict[str, float]
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield times and targets by joint up to `until`: every 0.01 s if there are several points.

    `aim` has the targets before the trajectory.
    """
    names = [name for name in path.joints if name in aim]
    ends = path.positions[:, [path.joints.index(name) for name in names]]
    if not names:
        return
    if len(ends) == 1:
        yield sent, dict(zip(names, ends[0].tolist(), strict=True))
        return
    knots = np.append(sent, sent + path.times)
    values = np.concatenate([[[aim[name] for name in names]], ends])
    times = np.arange(sent, min(knots[-1] + 0.005, until), 0.01)
    times = times[times < until]  # rounding
    rows = interpolated_columns(times, knots, values)
    for when, row in zip(times.tolist(), rows.tolist(), strict=True):
        yield when, dict(zip(names, row, strict=True))


def _measured(stream: _Stream) -> tuple[Series, Array]:
    """Return times and values, and ages if the stamps are of the clock of the recording."""
    recorded, stamps = np.array(stream.recorded), np.array(stream.stamps)
    ages, values = recorded - stamps, np.array(stream.values)
    if 0.0 <= float(np.median(ages)) <= _CLOCKS:
        return (stamps, values), np.clip(ages, 0.0, None)
    return (recorded, values), np.empty(0)


def _to_sec(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9
