import json
import os
import subprocess
from pathlib import Path

import pytest

PYTHON = os.environ.get("KINFEAS_LEROBOT_PYTHON")
SOURCE = Path(__file__).parents[1] / "examples" / "lerobot_robot_kinfeas"
RATES = ["--robot.fps=10", "--play_sounds=false"]
DATA = ["--dataset.repo_id=me/circles", "--dataset.root=circles"]

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
