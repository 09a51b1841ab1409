"""The documentation site can be built, without a warning."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
needs_sphinx = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("sphinx", "myst_parser", "furo")),
    reason='Sphinx is not installed: pip install "kinfeas[docs]"',
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site."""
    out = tmp_path_factory.mktemp("site")
    build = [
        sys.executable,
        "-m",
        "sphinx",
        "--fail-on-warning",
        "--keep-going",
        "--quiet",
        "--jobs",
        "2",
    ]
    done = subprocess.run(
        [*build, "--doctree-dir", out / "doctrees", DOCS, out / "html"],
        capture_output=True,
        text=True,
        timeout=900,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return out / "html"


@needs_sphinx
@pytest.mark.slow
def test_every_page_is_built(site):
    for page in DOCS.rglob("*.md"):
        assert (site / page.relative_to(DOCS).with_suffix(".html")).is_file(), page


@needs_sphinx
@pytest.mark.slow
def test_signatures_are_those_of_the_code(site):
    page = (site / "reference" / "motions.html").read_text()
    assert "Unit quaternions" in page or "quaternion" in page
    assert ">integrate<" in page
    assert "numpy.ndarray[" not in page


@needs_sphinx
@pytest.mark.slow
def test_commands_are_described(site):
    page = (site / "reference" / "command_line.html").read_text()
    for command in ("kinfeas train", "kinfeas deploy", "kinfeas plugins check"):
        assert f"<h2>{command}" in page
