from dataclasses import dataclass

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.training.state import Tally, checked, loading, read_state, write_state


@dataclass(frozen=True)
class Counts:
    """What a checkpoint might hold."""

    steps: Tally


def test_what_was_written_is_read(tmp_path):
    write_state(tmp_path, {"steps": 3, "about": {"best": 0.5}})
    assert read_state(tmp_path) == {"format": 1, "steps": 3, "about": {"best": 0.5}}


@pytest.mark.parametrize("content", ["", "[]", "{}", "3", '{"format": 2}', "[" * 100_000])
def test_what_is_no_state_is_a_clear_error(tmp_path, content):
    (tmp_path / "state.json").write_text(content)
    with pytest.raises(KinfeasError, match="broken checkpoint, or one of another run"):
        read_state(tmp_path)


def test_no_state_is_a_clear_error(tmp_path):
    with pytest.raises(KinfeasError, match="no checkpoint to resume: a file is missing"):
        read_state(tmp_path)


@pytest.mark.parametrize("steps", [-1, 1.5, "many", None])
def test_an_entry_that_is_not_allowed_is_named(tmp_path, steps):
    assert checked(Counts, {"steps": 3}) == Counts(3)
    wrong = pytest.raises(KinfeasError, match=r"broken checkpoint, .* state\.json: .*'steps'")
    with wrong, loading(tmp_path):
        checked(Counts, {"steps": steps})
