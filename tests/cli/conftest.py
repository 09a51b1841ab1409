"""Commands run in this process, as a shell would see them."""

import sys
from dataclasses import dataclass

import pytest

from kinfeas.cli import main

TINY = (
    "--set", "num_envs=8", "--set", "learner.batch_size=16", "--set", "learner.net_arch=[8]",
    "--set", "learner.buffer_size=1000", "--set", "learner.learning_starts=16",
    "--set", "schedule.evaluations=1", "--set", "schedule.evaluation_episodes=2",
    "--set", "schedule.final_episodes=2",
    "--set", "learner.gradient_steps=1",
)  # fmt: skip
"""Settings of a run that takes a second."""


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str


@pytest.fixture
def kinfeas(monkeypatch, capfd, tmp_path):
    """Return a function that runs `kinfeas ARGUMENTS` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Outcome:
        capfd.readouterr()  # what was printed before is not the command's
        monkeypatch.setattr(sys, "argv", ["kinfeas", *arguments])
        code = 0
        try:
            main.main()
        except SystemExit as end:
            code = int(end.code or 0)
        return Outcome(code, *capfd.readouterr())

    return run


def is_one_line(outcome: Outcome) -> bool:
    """Return whether a command ended as bad input has to: code 2, one line, no traceback."""
    return outcome.code == 2 and outcome.err.startswith("error: ") and outcome.err.count("\n") == 1
