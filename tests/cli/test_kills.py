import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.test_benchmark import STUDY
from tests.cli.test_sweep import SWEEP

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("KINFEAS_TEST_KILLS", "3"))
"""Kills of each case; the more, the longer. Cases of Ray take minutes: they need the variable."""

COMMANDS = {
    "benchmark": (("benchmark", "--config", "case.yaml"), STUDY, "table.json"),
    "sweep": (("sweep", "case.yaml", "--set", "sampler=random", "--set", "pruner=none"),
              SWEEP.replace("trials: 3", "trials: 8"), "sweep.json"),
}  # fmt: skip


def start(case, folder, *more):
    words, text, _ = COMMANDS[case]
    (folder / "case.yaml").write_text(text)
    command = [sys.executable, "-m", "kinfeas", *words, "--out", "out", *more]
    with (folder / "log").open("a") as log:
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def finish(case, folder, *more):
    process = start(case, folder, *more)
    assert process.wait(timeout=900) == 0, (folder / "log").read_text()[-3000:]
    return (folder / "out" / COMMANDS[case][2]).read_bytes()


def workers(driver, engine):
    """Return the processes below a driver that run jobs, by their command lines."""
    parents, lines = {}, {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            stat = (place / "stat").read_text().rpartition(")")[2].split()
            lines[int(place.name)] = (place / "cmdline").read_bytes().decode()
        except OSError:
            continue  # has ended meanwhile
        parents[int(place.name)] = int(stat[1])
    mark = r"ray::(_run_in|IDLE)" if engine == "ray" else "spawn_main"

    def below(pid):
        while pid in parents:
            pid = parents[pid]
            if pid == driver:
                return True
        return False

    return [pid for pid, line in lines.items() if re.search(mark, line) and below(pid)]


def kept(folder):
    found = [*folder.glob("out/results/*.json"), *folder.glob("out/runs/*/evaluation.json")]
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in found}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    tables = {}
    for case in COMMANDS:
        folder = tmp_path_factory.mktemp(case)
        tables[case] = finish(case, folder, "--processes", "1")
    return tables


@pytest.mark.parametrize("victim", ["worker", "driver"])
@pytest.mark.parametrize("engine", ["local", "ray"])
@pytest.mark.parametrize("case", COMMANDS)
def test_kills_change_nothing(whole, tmp_path, case, engine, victim):
    if engine == "ray" and "KINFEAS_TEST_KILLS" not in os.environ:
        pytest.skip("KINFEAS_TEST_KILLS is not set")
    rng = random.Random(f"{case} {engine} {victim}")
    more = ("--engine", engine, "--processes", "2")
    kills, before = 0, {}
    while kills < KILLS:
        process = start(case, tmp_path, *more)
        while process.poll() is None and kills < KILLS:
            time.sleep(rng.uniform(1.0, 10.0))
            victims = workers(process.pid, engine) if victim == "worker" else [process.pid]
            if process.poll() is None and victims:
                os.kill(rng.choice(victims), signal.SIGKILL)
                kills += 1
            now = kept(tmp_path)
            assert now.items() >= before.items()
            before = now
        code = process.wait(timeout=900)
        assert victim == "driver" or code == 0, (tmp_path / "log").read_text()[-3000:]
        if code == 0:
            break  # nothing is left to kill
    assert kills > 0
    assert finish(case, tmp_path, *more) == whole[case]
    assert kept(tmp_path).items() >= before.items()
