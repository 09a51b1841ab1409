"""The scripts of examples/ run as they stand there, and are as short as an example should be."""

import runpy
import sys
from pathlib import Path

import pytest

from kinfeas.core import registry

EXAMPLES = Path(__file__).parents[1] / "examples"
SAYS = {
    "deploy_in_process": ["--seconds", "2", "lines recorded"],
    "gymnasium_loop": ["--steps", "40", "40 steps, reward"],
    "ik_only": ["--poses", "100", "--goals", "2", "poses have a solution"],
    "own_generator": ["--episodes", "2", "2 episodes, success"],
    "own_task": ["--episodes", "1", "--robots", "pr2", "pr2: success"],
    "simulated_demonstrations": ["door", "--count", "1", "--out", "shown", "1 demonstrations"],
    "train_and_evaluate": ["--steps", "128", "--episodes", "1", "the run holds checkpoints"],
}


def test_every_example_is_tried():
    assert sorted(path.stem for path in EXAMPLES.glob("*.py")) == sorted(SAYS)


@pytest.mark.parametrize("name", sorted(SAYS))
def test_runs(name, monkeypatch, tmp_path, capsys):
    *arguments, says = SAYS[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_REGISTERED", [])
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert says in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} <= {"shown"}
