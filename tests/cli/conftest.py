"""Commands run in this process, as a shell would see them."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from kinfeas.cli import main
from kinfeas.config import to_options
from tests.builders import TRAINING

TINY = to_options(TRAINING)

STUDY = f"""
note: A very small one.
robots: [hsr]
tasks: [ggr]
baselines: {{follow_ee: [ggr]}}
trainings:
  - {{robot: hsr, steps: 64, settings: {json.dumps(TRAINING)}}}
seeds: [0, 1]
episodes: 2
settings: {{world.max_seconds: 2.5}}
"""


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str

    @property
    def facts(self):
        """What a command with `--json out.json` wrote."""
        return json.loads(Path("out.json").read_text())


@pytest.fixture
def kinfeas(monkeypatch, capfd, tmp_path):
    """Return a function that runs `kinfeas ARGUMENTS` in an empty folder and checks the code."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str, code: int | None = None) -> Outcome:
        # What was printed and written before is not the command's.
        capfd.readouterr()
        Path("out.json").unlink(missing_ok=True)
        monkeypatch.setattr(sys, "argv", ["kinfeas", *arguments])
        with pytest.raises(SystemExit) as end:
            main.main()
        out, err = capfd.readouterr()
        outcome = Outcome(int(end.value.code or 0), out, err)
        assert code in (None, outcome.code), outcome.err
        return outcome

    return run


def check_one_line(outcome: Outcome, named: str = "") -> None:
    """Check that a command ended as bad input has to: code 2, one line that names the input."""
    assert outcome.code == 2, outcome.err
    assert outcome.err.startswith("error: ")
    assert outcome.err.count("\n") == 1, outcome.err
    assert named in outcome.err


def write_demonstrations(folder, count, moving=True):
    """Write demonstrations of a reach to an object, with a base that follows."""
    folder.mkdir(exist_ok=True)
    rng, time = np.random.default_rng(0), np.linspace(0.0, 3.0, 60)
    done = (3.0 * (time / 3.0) ** 2 - 2.0 * (time / 3.0) ** 3) * moving
    names = [f"{kind}_{axis}" for kind in ("ee", "base", "object")
             for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]  # fmt: skip
    for number in range(count):
        table = np.zeros((len(time), 22))
        table[:, 0], table[:, [7, 14, 21]] = time, 1.0
        table[:, 1:4] = done[:, None] * [0.5, 0.2, 0.1] + rng.normal(0.0, 0.005, 3)
        table[:, 8] = 0.3 * done - 0.7
        table[:, 15:18] = [0.5, 0.2, 0.1]
        path = folder / f"{number}{'' if moving else '-still'}.csv"
        np.savetxt(path, table, delimiter=",", header=",".join(["time", *names]), comments="")
