import os
import subprocess
import sys
import time

from kinfeas.core import pose_kernels

USE = """
import numpy as np
from kinfeas.core import spatial
poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (4, 1))
spatial.integrate(poses, spatial.twist_between(poses, spatial.compose(poses, poses), 1.0), 1.0)
spatial.distance(poses, spatial.relative(poses, poses))
"""


def test_processes_may_compile_at_once(tmp_path):
    """Those that come later find kernels in the cache that fit together, and do not crash."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    processes = []
    for delay in (0.0, 0.2, 0.6):
        time.sleep(delay)
        processes.append(subprocess.Popen([sys.executable, "-c", USE], env=environment))
    assert [process.wait(timeout=120) for process in processes] == [0, 0, 0]
    subprocess.run([sys.executable, "-c", USE], env=environment, check=True, timeout=120)


def test_an_import_does_not_wait_for_a_lock_without_end(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(pose_kernels, "_END", time.monotonic())
    with pose_kernels._alone() as first, pose_kernels._alone() as second:
        assert (first, second) == (True, False)
        assert (tmp_path / "kinfeas" / "lock").exists()
