"""Compare golden figures with another revision to the bit: `python -m tests.golden.compare main`.

Patterns such as 'ik-*' after the revision choose figures. Exit code 1 if any array differs.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[2]

_COMPUTE = """
import sys
from fnmatch import fnmatch
import numpy as np
from tests.golden.figures import FIGURES

out, *patterns = sys.argv[1:]
for name, figure in FIGURES.items():
    if any(fnmatch(name, pattern) for pattern in patterns):
        np.savez_compressed(f"{out}/{name}.npz", **figure())
"""


def compute(tree, out, patterns):
    """Write the figures of `tests/golden/figures.py` in a folder with the packages beside it."""
    out.mkdir(exist_ok=True)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # sums depend on the threads
    command = [sys.executable, "-c", _COMPUTE, str(out), *patterns]
    subprocess.run(command, cwd=tree, env=environment, check=True)


def install(revision, folder):
    """Install a revision into a folder as from its wheel, with its tests."""
    archive, source = folder / "source.tar", folder / "source"
    subprocess.run(["git", "archive", "-o", archive, revision], cwd=ROOT, check=True)
    shutil.unpack_archive(archive, source, filter="data")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", folder / "site", source], check=True)
    shutil.copytree(source / "tests", folder / "site" / "tests")
    return folder / "site"


def changes(old, new):
    """Return the names of the arrays that differ in the last bit, or are in one file only."""
    before, after = (dict(np.load(path)) if path.exists() else {} for path in (old, new))
    both = before.keys() & after.keys()
    same = {key for key in both if np.array_equal(before[key], after[key])}
    return sorted((before.keys() | after.keys()) - same)


def main():
    """Compute the figures of both trees, print which arrays differ, and exit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("revision")
    parser.add_argument("patterns", nargs="*", default=["*"])
    options = parser.parse_args()
    with TemporaryDirectory() as temporary:
        old, new = Path(temporary, "old"), Path(temporary, "new")
        compute(install(options.revision, Path(temporary)), old, options.patterns)
        compute(ROOT, new, options.patterns)
        names = sorted({path.name for folder in (old, new) for path in folder.iterdir()})
        different = {name: changes(old / name, new / name) for name in names}
    if not names:
        parser.error("no figure has such a name")
    for name, keys in different.items():
        sys.stdout.write(f"{name.removesuffix('.npz')}: {', '.join(keys) or 'equal'}\n")
    sys.exit(any(different.values()))


if __name__ == "__main__":
    main()
