import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
import numba
import kinfeas.core.kernels
print(numba.config.CACHE_DIR)

@numba.njit(cache=True)
def double(x):
    return 2 * x

double(1)
print("now ours", file=sys.stderr)
kinfeas.core.kernels.square(1.0)
kinfeas.core.kernels.square(1)
"""


@pytest.fixture
def folder(tmp_path):
    return tmp_path / f"kinfeas-{os.getuid()}"


@pytest.fixture
def program(tmp_path):
    """A function that compiles a kernel where only the folder for temporary files is writable."""

    def run():
        (tmp_path / "program.py").write_text(PROGRAM)
        writable = {"TMPDIR": str(tmp_path), "XDG_CACHE_HOME": os.devnull, "NUMBA_CACHE_DIR": ""}
        environment = (
            os.environ | writable | {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
        )
        command = [sys.executable, tmp_path / "program.py"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return run


def test_kernels_are_cached_in_the_temporary_folder_without_another(program, folder):
    done = program()
    assert Path(done.stdout.strip()) == folder, done.stderr
    assert folder.stat().st_mode & 0o777 == 0o700
    assert list(folder.rglob("*.nbc"))


def test_first_calls_of_our_kernels_say_once_that_they_are_compiled(program):
    others, ours = program().stderr.split("now ours\n")
    assert "compiling" not in others
    assert ours == "compiling kernels (kept for next time)\n"


@pytest.mark.parametrize("linked", [False, True])
def test_a_folder_that_others_can_write_is_an_error(program, folder, tmp_path, linked):
    if linked:
        folder.symlink_to(tmp_path)
    else:
        folder.mkdir()
        folder.chmod(0o777)
    done = program()
    assert done.returncode == 1
    assert "KinfeasError" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr
