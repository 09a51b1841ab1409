import pytest

from kinfeas import __version__
from kinfeas.core.errors import KinfeasError
from kinfeas.training.train import resume, train


@pytest.fixture
def settings(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda tracker: tiny({"trackers": [tracker], "schedule.steps": 160})


def run_twice(settings, out):
    """Train a run and extend it, which goes on in the same run of the tracker."""
    train(settings, out)
    resume(out, settings={"schedule.steps": 320})


@pytest.mark.slow
def test_wandb_has_recipe_and_figures_offline(settings, tmp_path, monkeypatch):
    wandb = pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    seen, log = [], wandb.Run.log
    monkeypatch.setattr(
        wandb.Run, "log", lambda run, data, **o: (seen.append((run, data)), log(run, data, **o))
    )
    run_twice(settings("wandb"), tmp_path / "run")
    assert len(list((tmp_path / "run" / "wandb").glob("offline-run-*/*.wandb"))) == 2
    assert len({run.id for run, _ in seen}) == 1
    run, _ = seen[0]
    assert run.config["version"] == __version__
    assert run.config["learner"]["net_arch"]
    assert "fresh/success" in seen[-1][1]


def test_tensorboard_has_version_recipe_and_figures(settings, tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train(settings("tensorboard"), tmp_path / "run")
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert "fresh/success" in events.Tags()["scalars"]
    assert {"version/text_summary", "recipe/text_summary"} <= set(events.Tags()["tensors"])


def test_a_missing_library_is_an_error_before_anything_is_written(settings, tmp_path, monkeypatch):
    monkeypatch.setattr("kinfeas.core.extras.find_spec", lambda name: None)
    with pytest.raises(KinfeasError, match="wandb"):
        train(settings("wandb"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
