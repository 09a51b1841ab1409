import os
import subprocess
import sys

import pytest

from kinfeas.cli import completion
from kinfeas.policies import pretrained
from kinfeas.policies.loading import BASELINES


def test_policies_are_those_that_there_are():
    assert sorted(completion.POLICIES) == sorted([*BASELINES, pretrained.NAME])


def test_names_that_begin_so(tmp_path, monkeypatch):
    assert completion.plugins("robots")("p") == ["pr2"]
    assert {"pr2", "linear", "ggr", "analytic", "base_noise"} <= set(completion.every_plugin(""))
    monkeypatch.chdir(tmp_path)
    assert completion.policies("follow_ee_") == ["follow_ee_feedback"]
    (tmp_path / "runs" / "mine").mkdir(parents=True)
    (tmp_path / "runs" / "mine" / "config.yaml").write_text("")
    assert completion.policies("ru") == ["runs/mine"]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("kinfeas evaluate --robot ti", "tiago"),
        ("kinfeas plugins info lin", "linear"),
    ],
)
def test_the_shell_is_answered_without_heavy_imports(words, offered):
    code = (
        "import sys\n"
        "from kinfeas.cli.main import main\n"
        "sys.argv = ['kinfeas']\n"
        "try:\n    main()\nfinally:\n"
        "    heavy = {'numpy', 'numba', 'torch', 'matplotlib'} & set(sys.modules)\n"
        "    assert not heavy, heavy\n"
    )
    number = str(len(words.split()) - 1)
    asked = {"_KINFEAS_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": number}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == [offered]
    assert "AssertionError" not in done.stderr
