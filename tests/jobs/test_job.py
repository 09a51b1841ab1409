from pathlib import Path

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import ATTEMPTS, build_engine, run_jobs
from kinfeas.jobs.local import Local
from tests.jobs.job_cases import die, die_once, draw, fail, jobs

ROOT = Path(__file__).parents[2]


@pytest.fixture(params=["local", pytest.param("ray", marks=pytest.mark.slow)])
def engine(request, tmp_path, monkeypatch):
    """Each of the engines, with two processes."""
    monkeypatch.chdir(tmp_path)
    # Workers import the cases.
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.syspath_prepend(ROOT)
    if request.param == "ray":
        pytest.importorskip("ray")
    return build_engine(request.param, 2)


def files(folder):
    return {path.name: path.read_bytes() for path in (folder / "results").glob("*.json")}


def test_results_do_not_depend_on_the_engine_and_are_not_computed_again(engine, tmp_path):
    few = jobs(tmp_path, draw, draw, draw)
    done = []
    found = run_jobs(few, engine, lambda: done.append(1))
    assert found == [draw(job.description) for job in few]
    assert len(done) == 3
    before = files(tmp_path)
    assert run_jobs(jobs(tmp_path, fail, fail, fail), engine) == found
    for job in few:
        job.path.unlink()
    run_jobs(few, Local())
    assert files(tmp_path) == before


@pytest.mark.slow
def test_the_job_of_a_killed_worker_runs_again(engine, tmp_path):
    found = run_jobs(jobs(tmp_path, draw, die_once, draw), engine)
    assert [one["seed"] for one in found] == [0, 1, 2]


def test_errors_of_jobs_are_raised_and_keep_what_is_done(engine, tmp_path):
    run_jobs(jobs(tmp_path, draw), engine)
    with pytest.raises(KinfeasError, match="speed"):
        run_jobs(jobs(tmp_path, draw, fail), engine)
    assert files(tmp_path).keys() == {"0.json"}


def test_a_job_that_kills_each_worker_is_an_error(tmp_path, monkeypatch):
    rounds = []

    def engine(missing):
        rounds.append(len(missing))
        return iter(())

    with pytest.raises(KinfeasError, match=r"0\.json"):
        run_jobs(jobs(tmp_path, die), engine)
    assert rounds == [1] * ATTEMPTS


def test_an_interruption_keeps_finished_jobs(tmp_path):
    def interrupted(description):
        raise KeyboardInterrupt

    few = jobs(tmp_path, draw, interrupted, draw)
    with pytest.raises(KeyboardInterrupt):
        run_jobs(few, Local())
    assert files(tmp_path).keys() == {"0.json"}


def test_a_broken_file_is_an_error(tmp_path):
    (job,) = jobs(tmp_path, draw)
    run_jobs([job], Local())
    job.path.write_text('{"seed":')
    with pytest.raises(KinfeasError, match=r"0\.json"):
        run_jobs([job], Local())


@pytest.mark.parametrize(
    ("engine", "named"),
    [("roy", "ray"), ({"name": "local", "processes": "many"}, "processes"), ({"n": 1}, "name")],
)
def test_invalid_engines(engine, named):
    with pytest.raises(KinfeasError, match=named):
        build_engine(engine, 2)
