import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from kinfeas.core import kernel_cache
from kinfeas.core.errors import KinfeasError

USE = """
import numba
from kinfeas.core import kernel_cache
kernel_cache.settle()
print(numba.config.CACHE_DIR)
double = numba.njit(cache=True)(kernel_cache._any)
double()
"""
NOWHERE = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": ""}
"""What numba finds where neither the sources nor the home can be written."""


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """Numba with nowhere to cache, and a folder for temporary files."""

    def refuse(**_):
        def decorate(_):
            raise RuntimeError("no locator available")

        return decorate

    monkeypatch.setattr(numba, "njit", refuse)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
    return tmp_path


def test_kernels_are_cached_in_the_temporary_folder_without_another(tmp_path):
    environment = {**os.environ, **NOWHERE, "TMPDIR": str(tmp_path), "XDG_CACHE_HOME": os.devnull}
    done = subprocess.run(
        [sys.executable, "-c", USE], env=environment, check=True, capture_output=True, text=True
    )
    folder = tmp_path / f"kinfeas-{os.getuid()}"
    assert Path(done.stdout.strip()) == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    assert list(folder.rglob("*.nbc"))


def test_nothing_is_run_that_another_user_may_have_written(nowhere):
    folder = nowhere / f"kinfeas-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(KinfeasError, match="NUMBA_CACHE_DIR"):
        kernel_cache.settle()
    folder.rmdir()
    folder.symlink_to(nowhere)
    with pytest.raises(KinfeasError, match="NUMBA_CACHE_DIR"):
        kernel_cache.settle()
    assert not numba.config.CACHE_DIR
