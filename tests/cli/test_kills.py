import os
import random
import signal
import subprocess
import sys

import pytest

from tests.cli.test_benchmark import STUDY
from tests.cli.test_sweep import SWEEP

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("KINFEAS_TEST_KILLS", "3"))
CASES = {
    "benchmark": (("benchmark", "--config", "case.yaml"), STUDY, "table.json"),
    "sweep": (("sweep", "case.yaml", "--set", "sampler=random", "--set", "pruner=none"),
              SWEEP.replace("trials: 3", "trials: 8"), "sweep.json"),
}  # fmt: skip


def start(case, folder):
    words, text, _ = CASES[case]
    (folder / "case.yaml").write_text(text)
    command = [sys.executable, "-m", "kinfeas", *words, "--out", "out", "--processes", "2"]
    with (folder / "log").open("a") as log:
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def finish(case, folder):
    assert start(case, folder).wait(timeout=900) == 0, (folder / "log").read_text()[-3000:]
    return (folder / "out" / CASES[case][2]).read_bytes()


def results(folder):
    paths = [*folder.glob("out/results/*.json"), *folder.glob("out/runs/*/evaluation.json")]
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in paths}


@pytest.mark.parametrize("case", CASES)
def test_kills_change_nothing(tmp_path, case):
    """The command is killed at random moments; results of finished jobs stay as they are."""
    rng, before = random.Random(case), {}
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    for folder in (killed, whole):
        folder.mkdir()
    for _ in range(KILLS):
        process = start(case, killed)
        try:
            process.wait(timeout=rng.uniform(4.0, 15.0))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert results(killed).items() >= before.items()
        before = results(killed)
    assert finish(case, killed) == finish(case, whole)
    assert results(killed).items() >= before.items()
