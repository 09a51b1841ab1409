"""Commands run in this process, as a shell would see them."""

import sys
from dataclasses import dataclass

import pytest

from kinfeas.cli import main
from kinfeas.config import to_options

SETTINGS = {
    "num_envs": 8, "learner.batch_size": 16, "learner.net_arch": [8], "learner.buffer_size": 1000,
    "learner.learning_starts": 16, "schedule.evaluations": 1, "schedule.evaluation_episodes": 2,
    "schedule.final_episodes": 2, "learner.gradient_steps": 1,
}  # fmt: skip
"""Settings of a run that takes a second."""

TINY = to_options(SETTINGS)


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture
def kinfeas(monkeypatch, capfd, tmp_path):
    """Return a function that runs `kinfeas ARGUMENTS` in an empty folder and checks the code."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str, code: int | None = None) -> Outcome:
        capfd.readouterr()  # what was printed before is not the command's
        monkeypatch.setattr(sys, "argv", ["kinfeas", *arguments])
        with pytest.raises(SystemExit) as end:
            main.main()
        outcome = Outcome(int(end.value.code or 0), *capfd.readouterr())
        assert code in (None, outcome.code), outcome.err
        return outcome

    return run


def check_one_line(outcome: Outcome, named: str = "") -> None:
    """Check that a command ended as bad input has to: code 2, one line that names the input."""
    assert outcome.code == 2, outcome.err
    assert outcome.err.startswith("error: ")
    assert outcome.err.count("\n") == 1, outcome.err
    assert named in outcome.err
