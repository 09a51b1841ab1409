import json
import os
import subprocess

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, planar_pose
from kinfeas.io.demonstrations import Demonstration
from kinfeas.io.lerobot import write_lerobot_dataset
from tests.plugins.conftest import door_demonstrations

parquet = pytest.importorskip("pyarrow.parquet")

PYTHON = os.environ.get("KINFEAS_LEROBOT_PYTHON")
_READ = """
import json, sys
from lerobot.datasets import LeRobotDataset
from torch.utils.data import DataLoader
fps, state, action = 25, "observation.state", "action"
deltas = {state: [-1 / fps, 0.0], action: [0.0, 1 / fps]}
read = LeRobotDataset("kinfeas/shown", root=sys.argv[1], delta_timestamps=deltas)
batch = next(iter(DataLoader(read, batch_size=4)))
last = read[len(read) - 1]
print(json.dumps({
    "episodes": read.num_episodes, "frames": read.num_frames, "tasks": batch["task"],
    "names": read.meta.features[action]["names"], "fps": read.fps, "robot": read.meta.robot_type,
    "state": batch[state].tolist(), "action": batch[action].tolist(),
    "last": last["observation.environment_state"].tolist(),
    "mean": read.meta.stats[action]["mean"].tolist(),
}))
"""


@pytest.fixture(scope="module")
def shown():
    return door_demonstrations(3)


@pytest.fixture
def folder(shown, tmp_path):
    write_lerobot_dataset(shown, tmp_path / "set", "Open the door.", "pr2", fps=25)
    return tmp_path / "set"


def read(folder):
    """Return the table of a dataset, and its states and actions."""
    table = parquet.read_table(folder / "data/chunk-000/file-000.parquet")
    return table, *(np.stack(table[key].to_numpy()) for key in ("observation.state", "action"))


def check_actions(folder):
    """Check that actions are the poses of the next frame in the same episode."""
    table, state, action = read(folder)
    episode = table["episode_index"].to_numpy()
    same = episode[1:] == episode[:-1]
    np.testing.assert_array_equal(action[:-1][same], state[1:, :7][same])


def test_actions_are_the_poses_of_the_next_frame(shown, folder):
    check_actions(folder)
    table, state, _ = read(folder)
    episode, time = (table[key].to_numpy() for key in ("episode_index", "timestamp"))
    for number, one in enumerate(shown):
        mine = episode == number
        np.testing.assert_allclose(time[mine], np.arange(mine.sum()) / 25.0, atol=1e-4)
        assert 0.0 <= one.time[-1] - one.time[0] - mine.sum() / 25.0 < 1 / 25.0
        assert distance(one.ee_pose[0], state[mine][0, :7].astype(float))[1] < 1e-4
    about = json.loads((folder / "meta/info.json").read_text())
    assert (about["total_episodes"], about["total_frames"]) == (3, len(table))
    rows = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert rows["dataset_to_index"].to_pylist() == np.cumsum(np.bincount(episode)).tolist()


def test_quaternions_do_not_change_their_sign_within_an_episode(tmp_path):
    time = np.linspace(0.0, 4.0, 100)
    # 200 degrees, beginning with qw > 0, and beginning at a half turn.
    turned = [angle + np.deg2rad(200.0) * time / 4.0 for angle in (0.0, np.pi)]
    poses = [planar_pose(0.0 * time, 0.0 * time, angle) for angle in turned]
    shown = [Demonstration(time, pose, pose, pose) for pose in poses]
    write_lerobot_dataset(shown, tmp_path / "set", "Turn.")
    check_actions(tmp_path / "set")
    table = read(tmp_path / "set")[0]
    episode = table["episode_index"].to_numpy()
    features = {"observation.state": 2, "observation.environment_state": 1, "action": 1}
    for name, count in features.items():
        values = np.stack(table[name].to_numpy()).reshape(len(episode), count, 7)
        step = np.abs(np.diff(values[..., 3:], axis=0)).max(axis=(1, 2))
        assert step[episode[1:] == episode[:-1]].max() < 0.05
        assert name == "action" or (values[frames(episode) == 0, :, 6] >= 0.0).all()


def frames(episode):
    return np.arange(len(episode)) - np.searchsorted(episode, episode)


def test_folders_that_exist_are_kept(shown, folder):
    with pytest.raises(KinfeasError, match="set"):
        write_lerobot_dataset(shown, folder, "Open the door.")


@pytest.mark.slow
@pytest.mark.skipif(PYTHON is None, reason="needs KINFEAS_LEROBOT_PYTHON, Python with LeRobot")
def test_lerobot_reads_the_dataset(shown, folder, tmp_path):
    home = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    done = subprocess.run(
        [str(PYTHON), "-c", _READ, str(folder)],
        env=os.environ | home, cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout.splitlines()[-1])
    table, state, action = read(folder)
    assert (facts["episodes"], facts["frames"]) == (3, len(table))
    assert (facts["fps"], facts["robot"]) == (25, "pr2")
    assert facts["tasks"] == ["Open the door."] * 4
    assert facts["names"] == [f"ee_{axis}.pos" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    np.testing.assert_array_equal(np.array(facts["state"])[:, 1], state[:4])
    np.testing.assert_array_equal(np.array(facts["action"])[:, 0], action[:4])
    np.testing.assert_allclose(facts["last"], shown[-1].object_pose[-1], atol=1e-6)
    np.testing.assert_allclose(facts["mean"], action.mean(axis=0), atol=1e-5)
