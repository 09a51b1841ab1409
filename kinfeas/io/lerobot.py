"""Demonstrations as a LeRobot dataset, format v3.0: Parquet files and JSON below `meta/`.

Source of the format: `lerobot.datasets` of LeRobot 0.6, which this module does not need.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new, write_folder
from kinfeas.core.spatial import Array, continuous, interpolated
from kinfeas.io.demonstrations import Demonstration, columns

EE = tuple(f"{name}.pos" for name in columns("ee_pose"))
"""Names of the numbers of an EE pose in features; LeRobot's rollout needs the ending `.pos`."""

BASE = tuple(f"{name}.pos" for name in columns("base_pose"))
"""Names of the numbers of a base pose."""

TWIST = tuple(f"ee_{axis}.vel" for axis in ("x", "y", "z", "wx", "wy", "wz"))
"""Names of the numbers of an EE twist."""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def write_lerobot_dataset(
    demonstrations: Sequence[Demonstration],
    folder: Path,
    task: str,
    robot: str | None = None,
    fps: int = 30,
) -> None:
    """Write a new folder with an episode for each demonstration, resampled to `fps` frames/s.

    `observation.state` is the pose of the EE, followed by that of the base if all demonstrations
    have it; `observation.environment_state` is the pose of the object; `action` is the pose of the
    EE one frame later. Quaternions are xyzw with w >= 0 in the first state of an episode and no
    change of sign within it. `task` is the instruction in words, `robot` the type of the robot.

    Raises:
        KinfeasError: If there are no demonstrations, or the folder exists or cannot be written.
    """
    from pyarrow import Table, parquet

    if not demonstrations:
        raise KinfeasError("there must be at least one demonstration to write")
    with_base = all(demonstration.has_base for demonstration in demonstrations)
    state = ["ee_pose", "base_pose"] if with_base else ["ee_pose"]
    names = {
        "observation.state": [*EE, *BASE] if with_base else EE,
        "observation.environment_state": [f"{name}.pos" for name in columns("object_pose")],
        "action": EE,
    }
    episodes = _numbered([_frames(motion, state, fps) for motion in demonstrations], fps)
    whole = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
    about = {"robot_type": robot, "fps": fps, **_description(whole, names, len(episodes))}
    stats = {name: _statistics(values) for name, values in whole.items()}
    check_new(folder)

    def fill(folder: Path) -> None:
        meta, first = folder / "meta", _FILE.format(chunk_index=0, file_index=0)
        for path in (folder / "data" / first, meta / "episodes" / first):
            path.parent.mkdir(parents=True)
        tables = [_table(episode) for episode in episodes]
        with parquet.ParquetWriter(folder / "data" / first, tables[0].schema) as file:
            for table in tables:
                file.write_table(table)
        rows = Table.from_pylist([_row(episode, task) for episode in episodes])
        parquet.write_table(rows, meta / "episodes" / first)
        parquet.write_table(_tasks(task), meta / "tasks.parquet")
        for name, content in (("info", about), ("stats", stats)):
            (meta / f"{name}.json").write_text(json.dumps(content, indent=4), encoding="utf-8")

    write_folder(folder, fill)


def _frames(demonstration: Demonstration, state: list[str], fps: int) -> dict[str, Any]:
    """Return states, object poses and actions at `fps`; the last frame is an action only."""
    seconds = demonstration.time[-1] - demonstration.time[0]
    times = demonstration.time[0] + np.arange(max(2, int(seconds * fps + 1e-6) + 1)) / fps
    poses = {
        name: _at(times, demonstration.time, getattr(demonstration, name))
        for name in (*state, "object_pose")
    }
    return {
        "observation.state": np.concatenate([poses[name][:-1] for name in state], axis=1),
        "observation.environment_state": poses["object_pose"][:-1],
        "action": poses["ee_pose"][1:],
    }


def _at(times: Array, sample_times: Array, poses: Array) -> Any:
    """Return poses, (m, 7), at `times`, interpolated between `poses`, (t, 7), of samples."""
    poses_at = interpolated(np.clip(times, sample_times[0], sample_times[-1]), sample_times, poses)
    poses_at[:, 3:] = continuous(poses_at[:, 3:])
    return poses_at.astype(np.float32)


def _numbered(episodes: list[dict[str, Any]], fps: int) -> list[dict[str, Any]]:
    numbered, begin = [], 0
    for number, frames in enumerate(episodes):
        count = np.arange(len(frames["action"]))
        numbered.append({
            **frames,
            "timestamp": (count / fps).astype(np.float32), "frame_index": count,
            "episode_index": np.full_like(count, number), "index": begin + count,
            "task_index": np.zeros_like(count),
        })  # fmt: skip
        begin += len(count)
    return numbered


def _description(
    whole: Mapping[str, Any], names: Mapping[str, Sequence[str]], episodes: int
) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "total_episodes": episodes, "total_frames": len(whole["index"]), "total_tasks": 1,
        "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
        "splits": {"train": f"0:{episodes}"},
        "data_path": f"data/{_FILE}", "video_path": None,
        "features": {
            name: {
                "dtype": values.dtype.name,
                "shape": [1] if values.ndim == 1 else [values.shape[1]],
                "names": names.get(name),
            }
            for name, values in whole.items()
        },
    }  # fmt: skip


def _row(frames: dict[str, Any], task: str) -> dict[str, Any]:
    begin, length = int(frames["index"][0]), len(frames["index"])
    statistics = {
        f"stats/{name}/{key}": value
        for name, values in frames.items()
        for key, value in _statistics(values).items()
    }
    return {
        "episode_index": int(frames["episode_index"][0]), "tasks": [task], "length": length,
        "data/chunk_index": 0, "data/file_index": 0,
        "dataset_from_index": begin, "dataset_to_index": begin + length, **statistics,
        "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
    }  # fmt: skip


def _table(frames: dict[str, Any]) -> Any:
    import pyarrow as pa

    def column(values: Any) -> Any:
        if values.ndim == 1:
            return pa.array(values)
        return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])

    return pa.table({name: column(values) for name, values in frames.items()})


def _statistics(values: Any) -> dict[str, Any]:
    rows = values.reshape(len(values), -1).astype(np.float64)
    statistics = {
        "min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0),
        "std": rows.std(axis=0), "count": np.array([len(rows)]),
    }  # fmt: skip
    statistics |= {key: np.quantile(rows, quantile, axis=0) for key, quantile in _QUANTILES.items()}
    return {key: value.tolist() for key, value in statistics.items()}


def _tasks(task: str) -> Any:
    """Return the table of tasks; its pandas index is the text of the task."""
    import pyarrow as pa

    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    number = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64"}
    described = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0",
        "columns": [{**number, "numpy_type": "int64", "metadata": None},
                    {**index, "metadata": None}],
    }  # fmt: skip
    table = pa.table({"task_index": pa.array([0]), "task": pa.array([task])})
    return table.replace_schema_metadata({"pandas": json.dumps(described)})
