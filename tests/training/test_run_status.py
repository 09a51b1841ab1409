import json
import shutil

import pytest

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.io.policy_metadata import Trained, write_trained
from kinfeas.training.progress import Progress
from kinfeas.training.run_status import (
    evaluations_due,
    finished,
    identity,
    read_settings,
    read_standing,
    share_done,
)
from kinfeas.training.state import write_state


@pytest.fixture
def write_best(tmp_path):
    """Return a function that writes what is known of the best checkpoint."""
    best = tmp_path / "checkpoints" / "best"
    best.mkdir(parents=True)
    return lambda fresh: write_trained(Trained(robot="pr2", layers=3, fresh_evaluation=fresh), best)


@pytest.fixture
def stand(tiny, tmp_path, write_best):
    """Return a function that writes a run, its settings and how far it is, and returns both."""

    def write(*overrides, steps=1600, seconds=9.0, evaluations=2):
        settings = tiny(*overrides)
        progress = Progress(steps, seconds, evaluations=evaluations)
        last = tmp_path / "checkpoints" / "last"
        last.mkdir(parents=True, exist_ok=True)
        config.dump(settings, tmp_path / "config.yaml")
        write_state(last, {"config": identity(settings), "progress": progress.saved()})
        write_best({"success": 0.5})
        return settings, last

    return write


@pytest.mark.parametrize(
    ("schedule", "share"),
    [
        ("{steps: 2000, minutes: null}", 0.2),
        ("{steps: null, minutes: 2}", 0.25),
        ("{steps: 2000, minutes: 2}", 0.25),
        ("{steps: 2000, minutes: 20}", 0.2),
        ("{steps: 300, minutes: 20}", 1.0),
    ],
)
def test_steps_or_time_end_a_run_whichever_comes_first(tiny, schedule, share):
    settings = tiny(f"schedule={schedule}")
    assert share_done(settings.schedule, Progress(400, 30.0)) == share


@pytest.mark.parametrize(("init", "first"), [("null", 0), ("pretrained", 1)])
def test_what_a_run_goes_on_from_is_judged_too(tiny, init, first):
    settings = tiny(f"init={init}", "schedule.evaluations=4")
    due = [evaluations_due(settings, Progress(share=share)) for share in (0.0, 0.24, 0.5, 1.0)]
    assert due == [first, first, first + 2, first + 4]


def test_a_run_whose_best_checkpoint_is_not_judged_afresh_is_not_finished(
    stand, write_best, tmp_path
):
    stand()
    write_best({})
    assert finished(tmp_path) is None


def test_a_run_with_nothing_left_to_do_is_finished(stand, tmp_path):
    stand()
    progress = finished(tmp_path)
    assert (progress.steps, progress.seconds, progress.share) == (1600, 9.0, 1.0)


@pytest.mark.parametrize("left", [{"steps": 1592}, {"evaluations": 1}])
def test_a_run_with_something_left_to_do_is_not(stand, tmp_path, left):
    stand(**left)
    assert finished(tmp_path) is None


def test_a_run_that_has_only_begun_is_not(stand, tmp_path):
    stand()
    shutil.rmtree(tmp_path / "checkpoints")
    assert finished(tmp_path) is None


def test_a_longer_schedule_has_something_left(stand, tmp_path):
    settings, last = stand()
    longer = config.from_mapping(
        type(settings), config.to_mapping(settings), "longer", ["schedule.steps=3200"]
    )
    config.dump(longer, tmp_path / "config.yaml")
    assert finished(tmp_path) is None
    progress = read_standing(longer, last)
    assert (progress.share, progress.evaluations) == (0.5, 1)


def test_a_checkpoint_of_another_run_is_a_clear_error(stand, tiny, tmp_path):
    _, last = stand()
    with pytest.raises(KinfeasError, match=rf"of another run: its seed is 0, but {tmp_path}/conf"):
        read_standing(tiny("seed=3"), last)


def test_a_broken_checkpoint_is_a_clear_error(stand, tmp_path):
    _, last = stand()
    state = json.loads((last / "state.json").read_text())
    (last / "state.json").write_text(json.dumps({**state, "progress": {}}))
    with pytest.raises(KinfeasError, match="last: broken checkpoint, or one of another run"):
        finished(tmp_path)


def test_a_folder_that_is_no_run_is_a_clear_error(tmp_path):
    with pytest.raises(KinfeasError, match="not a training run"):
        read_settings(tmp_path)
