"""The documentation site builds without warnings."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
def test_the_site(tmp_path):
    for package in ("sphinx", "myst_parser", "furo", "sphinx_copybutton"):
        pytest.importorskip(package, reason='pip install "kinfeas[docs]"')
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", tmp_path / "trees"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, DOCS, tmp_path / "site"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for page in DOCS.rglob("*.md"):
        assert (tmp_path / "site" / page.relative_to(DOCS).with_suffix(".html")).is_file()
    modules = (tmp_path / "site" / "reference" / "motions.html").read_text()
    assert ">integrate<" in modules
    assert "numpy.ndarray[" not in modules  # aliases by name
    commands = (tmp_path / "site" / "reference" / "command_line.html").read_text()
    assert "<h2>kinfeas plugins check" in commands
