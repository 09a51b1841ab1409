import json
import os
import subprocess
from pathlib import Path

import pytest

PYTHON = os.environ.get("KINFEAS_LEROBOT_PYTHON")
SOURCE = Path(__file__).parents[1] / "examples" / "lerobot_robot_kinfeas"
RATES = ["--robot.fps=10", "--play_sounds=false"]
DATA = ["--dataset.repo_id=me/circles", "--dataset.root=circles"]
CHUNK = """
import numpy as np
import torch
from lerobot.processor import PolicyProcessorPipeline, RelativeActionsProcessorStep
from lerobot.processor import policy_action_to_transition, transition_to_policy_action
from lerobot_robot_kinfeas import Kinfeas, KinfeasConfig, RelativeChunk

from kinfeas.core import spatial

robot = Kinfeas(KinfeasConfig(fps=10.0))
robot.connect()
seen = np.array(list(robot.get_observation().values()))[:7]
begin = RelativeActionsProcessorStep()
begin({"observation": {"observation.state": torch.tensor(seen[None])}})
PolicyProcessorPipeline(
    steps=[RelativeChunk()], to_transition=policy_action_to_transition,
    to_output=transition_to_policy_action,
).save_pretrained("post", config_filename="post.json")
post = PolicyProcessorPipeline.from_pretrained(
    "post", config_filename="post.json", to_transition=policy_action_to_transition,
    to_output=transition_to_policy_action,
)
post.steps[0].relative_step = begin
turns = 0.02 * np.arange(1.0, 21.0)
poses = spatial.planar_pose(turns / 5.0, turns / 4.0, turns)
columns = spatial.rotation(poses).as_matrix()[:, :, :2].transpose(0, 2, 1).reshape(-1, 6)
chunk = torch.tensor(np.concatenate([poses[:, :3], columns], axis=1))[None]
world = post(chunk)[0].numpy()
np.testing.assert_allclose(spatial.relative(world, np.tile(seen, (20, 1))), poses, atol=1e-6)
for pose in [*world, *world[[-1] * 10]]:
    robot.send_action(dict(zip(robot.action_features, pose)))
reached = np.array(list(robot.get_observation().values()))[:7]
assert max(spatial.distance(reached[None], world[-1:])) < 0.01
try:
    post(chunk[0, :1])
    raise SystemExit("single actions must raise an error")
except ValueError:
    pass
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        PYTHON is None, reason="needs KINFEAS_LEROBOT_PYTHON, Python with LeRobot and kinfeas"
    ),
]


@pytest.fixture
def program(tmp_path):
    environment = os.environ | {
        "HF_HUB_OFFLINE": "1",
        "HF_HOME": str(tmp_path / "home"),
        "PYTHONPATH": str(tmp_path / "site"),
    }

    def run(*words: str) -> None:
        done = subprocess.run(
            [str(PYTHON), "-m", *words],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr

    run("pip", "install", "-q", "--no-deps", "--target", "site", str(SOURCE))
    return run


@pytest.mark.parametrize(("action", "names"), [("pose", 7), ("twist", 6)])
def test_recordings_are_replayed(program, tmp_path, action, names):
    given = [*RATES, *DATA, "--robot.type=kinfeas", f"--robot.action={action}"]
    program(
        "lerobot.scripts.lerobot_record", *given, "--dataset.fps=10", "--dataset.num_episodes=1",
        "--dataset.episode_time_s=3", "--dataset.single_task=Circle.",
        "--dataset.push_to_hub=false", "--teleop.type=kinfeas_circle", "--teleop.fps=10",
        f"--teleop.action={action}",
    )  # fmt: skip
    about = json.loads((tmp_path / "circles/meta/info.json").read_text())
    assert about["total_frames"] > 5
    assert len(about["features"]["action"]["names"]) == names
    stats = json.loads((tmp_path / "circles/meta/stats.json").read_text())["observation.state"]
    assert stats["max"][1] > stats["min"][1] + 0.01
    program("lerobot.scripts.lerobot_replay", *given, "--dataset.episode=0")


def test_relative_chunks_become_world_poses_that_the_robot_reaches(program, tmp_path):
    (tmp_path / "site" / "chunk_check.py").write_text(CHUNK)
    program("chunk_check")
