from pathlib import Path

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import ATTEMPTS, build_engine, run_jobs
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
    results = run_jobs(few, engine, lambda: done.append(1))
    assert results == [draw(job.description) for job in few]
    assert len(done) == 3
    before = files(tmp_path)
    assert run_jobs(jobs(tmp_path, fail, fail, fail), engine) == results
    for job in few:
        job.path.unlink()
    run_jobs(few, build_engine("local"))
    assert files(tmp_path) == before


@pytest.mark.slow
def test_the_job_of_a_killed_worker_runs_again(engine, tmp_path):
    results = run_jobs(jobs(tmp_path, draw, die_once, draw), engine)
    assert [result["seed"] for result in results] == [0, 1, 2]


def interrupted(description):
    raise KeyboardInterrupt


def test_errors_of_jobs_and_interruptions_keep_what_is_done(engine, tmp_path):
    run_jobs(jobs(tmp_path, draw), engine)
    with pytest.raises(KinfeasError, match="speed"):
        run_jobs(jobs(tmp_path, draw, fail), engine)
    with pytest.raises(KeyboardInterrupt):
        run_jobs(jobs(tmp_path, draw, interrupted), build_engine("local"))
    assert files(tmp_path).keys() == {"0.json"}
    (job,) = jobs(tmp_path, draw)
    job.path.write_text('{"seed":')
    with pytest.raises(KinfeasError, match=r"0\.json"):
        run_jobs([job], engine)


def test_a_job_that_kills_each_worker_is_an_error(tmp_path, monkeypatch):
    rounds = []

    def engine(missing):
        rounds.append(len(missing))
        return iter(())

    with pytest.raises(KinfeasError, match=r"0\.json"):
        run_jobs(jobs(tmp_path, die), engine)
    assert rounds == [1] * ATTEMPTS


@pytest.mark.slow
def test_addresses_of_no_cluster_are_errors(tmp_path):
    pytest.importorskip("ray")
    with pytest.raises(KinfeasError, match="address"):
        run_jobs(jobs(tmp_path, draw), build_engine("ray", address="nonsense"))
