import json
from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.benchmark.cells import run_jobs
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.benchmark.physics import tabulate_physics
from kinfeas.benchmark.physics_text import physics_markdown
from kinfeas.benchmark.plot import table_figure
from kinfeas.benchmark.records import to_lists
from kinfeas.benchmark.study import BenchmarkConfig, read_benchmark
from kinfeas.benchmark.table import tabulate, to_json
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.physics import PhysicsSettings
from kinfeas.evaluation.evaluate import evaluation_world
from kinfeas.evaluation.physics.world import PhysicsRecords
from tests.benchmark.benchmark_cases import PHYSICS_STUDY, physics_plan


def records(successes):
    failures = np.where(successes, 0, 7)
    count = len(successes)
    return PhysicsRecords(
        reached=np.array(successes),
        failures=failures,
        max_deviation=np.full(count, 0.01),
        mean_deviation=np.full(count, 0.002),
        final_distance=np.where(successes, 0.01, np.inf),
        joint_jumps=np.zeros(count, dtype=int),
        steps=np.full(count, 500),
        done=np.array(successes),
        base_collisions=np.ones(count, dtype=int),
        arm_collisions=np.zeros(count, dtype=int),
    )


def found(*overrides):
    """Return jobs and results: three of four episodes succeed everywhere, four without physics."""
    jobs = physics_plan("episodes=4", *overrides)
    results = []
    for job in jobs:
        figures = {"success": 1.0, "within_5cm": 1.0, "ik_failures_per_episode": 0.0}
        figures |= {
            "mean_deviation_m": 0.0,
            "joint_jumps_per_episode": 0.0,
            "low": 0.9,
            "high": 1.0,
        }
        result = {"figures": figures}
        if job.physical:
            result["records"] = to_lists(records([True, True, True, False]))
        results.append(result)
    return jobs, results


def cells(*overrides):
    jobs, results = found(*overrides)
    split = [
        [pair for pair in zip(jobs, results, strict=True) if pair[0].physical == physical]
        for physical in (False, True)
    ]
    (analytic, physical) = (list(zip(*pairs, strict=True)) for pairs in split)
    return tabulate_physics(*physical, tabulate(*analytic))


def test_cells_put_parts_together_and_stand_beside_the_paper():
    found = {(cell.robot, cell.task, *cell.row): cell for cell in cells()}
    plain = found["pr2", "ggr", "pretrained", ""]
    assert (plain.world, plain.episodes_per_seed, plain.success) == ("pybullet", 4, 0.75)
    assert (plain.analytic_success, plain.paper_success) == (1.0, 0.802)
    assert (plain.task_success, plain.base_collisions, plain.collision_free_rate) == (
        0.75,
        1.0,
        0.0,
    )
    ahead = found["pr2", "ggr", "pretrained", "head start"]
    assert (ahead.paper_success, ahead.head_start, ahead.variant) == (0.87, 3.0, "head_start")
    bare = found["hsr", "door", "pretrained", "no objects"]
    assert (bare.task_success, bare.objects, bare.paper_success) == (None, False, 0.872)
    assert found["pr2", "ggr", "follow_ee", ""].paper_success == 0.482
    entries = json.loads(json.dumps(to_json(list(found.values())), allow_nan=False))
    assert {"success_std", "ceiling", "task_success", "arm_collisions"} <= set(entries[0])


def test_a_task_by_path_goes_by_its_name(tmp_path):
    path = tmp_path / "fetch.yaml"
    path.write_text("name: x\nplaces: {cup: {position: [2, 0, 0.8]}}\nsubgoals: [{place: cup}]\n")
    made = cells("robots=[pr2]", f"tasks=[ggr,{path}]", f"baselines={{follow_ee: [{path}]}}")
    named = {(cell.task, cell.policy) for cell in made}
    assert named == {("ggr", "pretrained"), ("fetch", "pretrained"), ("fetch", "follow_ee")}


def test_the_table_and_the_picture_show_all_rows():
    text = physics_markdown(cells(), "A note.", ["kinfeas benchmark"], ["table.png"])
    for words in ("A note.", "2 times longer", "head start", "*80.2 (83.6)*", "without physics"):
        assert words in text
    assert "1.00 / 0.00 (0.0)" in text
    axes = table_figure(cells()).axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["learned, pretrained", "learned, pretrained, head start",
                     "learned, pretrained, no objects", "follow_ee"]  # fmt: skip


def test_a_part_is_run_once(tmp_path):
    pytest.importorskip("pybullet")
    world = PhysicsSettings(max_seconds=0.2)
    job = Job("hsr", "ggr", {}, "", "follow_ee", "follow_ee", None, 2, 1, world, first=5)
    (result,) = run_jobs([job], tmp_path)
    assert len(result["records"]["done"]) == result["figures"]["episodes"] == 2
    assert result["records"]["steps"] == [10, 10]
    assert run_jobs([job], tmp_path) == [result]
    assert len(list(tmp_path.iterdir())) == 1
    # Other episodes are another part.
    run_jobs([replace(job, first=7)], tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_parts_leave_what_the_analytic_world_found_where_it_is():
    from kinfeas.benchmark.identity import identity

    plain = Job("pr2", "ggr", {}, "", CEILING, CEILING, None, 4, 1, evaluation_world())
    assert "first" not in identity(plain)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("physics.rows={other: {}}", "'plain'"),
        ("physics.settings=['world.slow_dwn=2']", "slow_dwn"),
        ("physics.rows.plain.task=[ggr]", "unknown key"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, override, words):
    config.dump(
        config.from_mapping(BenchmarkConfig, PHYSICS_STUDY, "study"), tmp_path / "study.yaml"
    )
    with pytest.raises(KinfeasError, match=words):
        read_benchmark(str(tmp_path / "study.yaml"), [override])
