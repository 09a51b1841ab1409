"""Robots that are known, identified from records and bags of their runs."""

import json
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.api.identify import drive, identify
from kinfeas.api.load import read_adapters
from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.config.recipes import default_engine
from kinfeas.control.assemble import build_backend, with_adapters
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import interpolated_columns
from kinfeas.io.run_log import read_record
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.sim2real.identify.excitation import arm_amplitude, arm_pattern, base_pattern
from kinfeas.sim2real.identify.fit import fit
from kinfeas.sim2real.identify.log import Log, log_of
from kinfeas.sim2real.identify.model import (
    Delays,
    Track,
    arm_delay,
    delayed,
    moved_arm,
    moved_base,
)
from kinfeas.sim2real.identify.statistics import base_noise, joint_noise, standard_errors
from kinfeas.viz.plots import velocities_figure
from tests.builders import at, twist

TRUTH = {
    "base_noise": {"linear": 0.04, "angular": 0.03},
    "actuator_lag": {"base": 0.15, "arm": 0.03},
    "acceleration_limit": {"linear": 0.6, "angular": 1.2},
    "command_latency": {"seconds": 0.07, "jitter": 0.03},
    "joint_noise": {"deviation": 0.002},
    "localisation": {
        "drift": 0.006, "turn_drift": 0.004, "jump": 0.03, "turn_jump": 0.02, "rate": 0.2
    },
    "sensor_latency": {"seconds": 0.03, "jitter": 0.02},
}  # fmt: skip
TIMES = ("actuator_lag.base", "actuator_lag.arm", "command_latency.seconds",
         "sensor_latency.seconds")  # fmt: skip
LIMITS = ("acceleration_limit.linear", "acceleration_limit.angular")
NOISE = ("base_noise.linear", "base_noise.angular", "joint_noise.deviation")
DT = 0.02


def driven(folder, robot="hsr", truth=TRUTH, **options):
    """Return the record of a robot within adapters."""
    record, adapters = folder / "run.csv", folder / "truth.yaml"
    entries = [{"name": name, **numbers} for name, numbers in truth.items()]
    adapters.write_text(json.dumps({"adapters": entries}))  # which is YAML, too
    options = {"backend": "analytic", "real_time": False, **options}
    outcome = drive(robot, record=record, adapters=adapters, **options).outcome
    assert outcome.code == 0, outcome.reason
    return record


@pytest.fixture(scope="session")
def record(tmp_path_factory):
    return driven(tmp_path_factory.mktemp("record"), seed=3)


def check(found) -> None:
    for names, most in ((TIMES, {"abs": 0.015}), (LIMITS, {"rel": 0.15}), (NOISE, {"rel": 0.3})):
        for name in names:
            adapter, key = name.split(".")
            assert found.estimates[name].value == pytest.approx(TRUTH[adapter][key], **most), name


def test_robot_is_found_and_its_file_is_a_list_of_adapters(record, tmp_path, hsr):
    out, picture = tmp_path / "my_robot.yaml", tmp_path / "fit.png"
    found = identify(record, out=out, picture=picture)
    check(found)
    assert found.response.base_lag == found.estimates["actuator_lag.base"].value
    assert found.response.command_latency == pytest.approx(0.07 + 0.015, abs=0.015)
    specs = read_adapters(out)
    assert [spec.name for spec in specs] == [spec.name for spec in found.adapters]
    with_adapters(build_backend("analytic", {}), specs, hsr)
    assert picture.stat().st_size > 10_000
    assert json.loads(json.dumps(found.facts()))["robot"] == "hsr"


def test_records_of_an_arm_at_rest_show_latency_and_joint_noise(record, monkeypatch):
    run, noise = read_record(record), TRUTH["joint_noise"]["deviation"]
    aims = np.repeat(run.joint_targets[:1], len(run.time), axis=0)
    joints = aims + np.random.default_rng(0).normal(scale=noise, size=aims.shape)
    changed = replace(run, joint_targets=aims, joint_positions=joints)
    monkeypatch.setattr("kinfeas.api.identify.read_record", lambda path: changed)
    found = identify("run.csv", "hsr")
    latency = found.estimates["command_latency.seconds"]
    assert latency.low <= 0.07 + 0.015 <= latency.high < 0.2
    assert found.estimates["joint_noise.deviation"].value == pytest.approx(noise, rel=0.3)
    assert ".inf" not in found.adapter_lines and ".nan" not in found.adapter_lines


def test_errors_are_infinite_where_residuals_depend_on_nothing():
    rng = np.random.default_rng(0)
    derivatives = np.stack([rng.normal(size=50), np.full(50, 1e-9)], axis=1)
    errors = standard_errors(rng.normal(size=50), derivatives, np.arange(50))
    assert 0.0 < errors[0] < 1.0 and errors[1] == np.inf


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pr2", "tiago"])
def test_other_robots_are_found(tmp_path, robot):
    check(identify(driven(tmp_path, robot, seed=4)))


@pytest.mark.slow
def test_robot_without_delays_has_none(tmp_path):
    found = identify(driven(tmp_path, truth={}))
    assert found.response.command_latency < 0.005
    assert found.response.base_lag < 0.005
    assert found.response.acceleration is None
    assert found.response.jerk is None and found.response.rotation_jerk is None
    assert found.estimates["dropped_commands.probability"].low == 0.0
    assert "joint_noise" not in [spec.name for spec in found.adapters]
    assert any("no limit of the linear acceleration" in sentence for sentence in found.missing)


def test_chain_is_that_of_the_adapters(hsr):
    limits = {"linear": 0.5, "angular": 1.0, "linear_jerk": 5.0, "angular_jerk": 10.0}
    specs = [
        PluginSpec("actuator_lag", {"base": 0.1, "arm": 0.05}),
        PluginSpec("acceleration_limit", limits),
        PluginSpec("command_latency", {"seconds": 0.05}),
    ]
    backend = with_adapters(AnalyticBackend(), specs, hsr)
    backend.seed(np.zeros(1, dtype=np.uint64), np.array([0]))
    backend.reset(at(), np.zeros((1, 5)))
    rng, n = np.random.default_rng(0), 200
    sent = np.repeat(rng.uniform(-0.3, 0.3, size=(n // 20, 3)), 20, axis=0)
    targets = np.cumsum(rng.normal(scale=0.01, size=(n, 5)), axis=0)
    steps = zip(sent, targets, strict=True)
    states = [backend.step(twist(*velocity), target[np.newaxis], DT) for velocity, target in steps]
    weights, before = Delays(0.05).weights(DT), np.zeros((1, 5))
    active = delayed(np.concatenate([before[:, :3], sent]), weights)
    means = moved_base(active, DT, 0.1, np.array([0.5, 1.0]), np.array([5.0, 10.0]))[1:]
    way = np.array([state.base_pose[0, :2] for state in states])
    np.testing.assert_allclose(np.cumsum(means, axis=0)[:, :2] * DT, way, atol=1e-4)
    arm = moved_arm(delayed(np.concatenate([before, targets]), weights), DT, 0.05)[1:]
    np.testing.assert_allclose(arm, [s.joint_positions[0] for s in states], atol=1e-3)


@pytest.mark.parametrize("seconds", [0.0, DT, 0.1, 0.5])
def test_delay_of_cubics_is_that_at_constant_velocity(seconds):
    times = np.arange(500)[:, np.newaxis] * DT
    late = (times - moved_arm(times, DT, 0.0, seconds))[-1, 0]
    assert arm_delay(DT, seconds) == pytest.approx(late, abs=1e-9)


@pytest.mark.slow
def test_latency_is_found_behind_an_arm_on_trajectories(tmp_path):
    """Such an arm is later than the base, by a time that the record tells."""
    pytest.importorskip(default_engine())
    record = driven(tmp_path, "pr2", backend=default_engine())
    seconds = read_record(record).about.arm_seconds
    assert seconds > DT
    found, delays = identify(record).estimates, TRUTH["command_latency"]
    assert found["command_latency.seconds"].value == pytest.approx(delays["seconds"], abs=0.015)
    lag = TRUTH["actuator_lag"]["arm"] + arm_delay(DT, seconds)
    assert found["actuator_lag.arm"].value == pytest.approx(lag, abs=0.015)


def test_arms_earlier_than_their_trajectories_lose_no_commands():
    """Motors with feedforward, as in MuJoCo, are ahead of cubics that end at rest."""
    rng, times, late = np.random.default_rng(0), np.arange(1, 2000) * DT, 0.04
    moving = np.sin(np.maximum(np.arange(2000) * DT - 4.0, 0.0))[:, np.newaxis]
    joints = interpolated_columns(times - late, np.arange(2000) * DT, moving)
    joints += rng.normal(scale=1e-5, size=joints.shape)
    rest, ages = np.zeros((2000, 3)), np.empty(0)
    found = fit(
        [Log("record", DT, rest, moving[1:], times, rest[1:], times, joints, ages, 0.1)], (0, 0)
    )
    assert found.estimates["dropped_commands.probability"].value < 0.01
    assert found.estimates["actuator_lag.arm"].value == pytest.approx(late, abs=0.015)


def test_noise_is_found_with_periods_of_its_own():
    """A simulator or driver at another rate evens out what is measured between its periods."""
    rng, n, noise = np.random.default_rng(0), 8000, 0.04
    drawn = rng.normal(scale=noise, size=(n, 3))
    times = np.arange(1, n - 1) * DT + rng.uniform(0.0, 0.5 * DT, size=n - 2)

    def measured(values):
        own = np.arange(n) * DT + 0.4 * DT
        return interpolated_columns(times, own, values)

    base, joints, rest = measured(np.cumsum(drawn * DT, axis=0)), measured(drawn), np.zeros((n, 3))
    log = Log("record", DT, rest, rest, times, base, times, joints, np.empty(0), 0.0)
    assert joint_noise([log], [times / DT])[0].value == pytest.approx(noise, rel=0.05)
    found = base_noise([Track(log)], [rest], (0.0, 0.0), [])
    for axis in ("linear", "angular"):
        assert found[f"base_noise.{axis}"].value == pytest.approx(noise, rel=0.08)


def test_motion_while_nothing_was_measured_is_no_jump_of_the_localisation():
    walk = np.cumsum(np.random.default_rng(0).normal(scale=1e-3, size=(1000, 3)), axis=0)
    walk[600:] += 0.4
    times, rest, none = np.arange(1, 1001) * DT, np.zeros((1000, 3)), np.empty(0)
    for kept, jumps in ((times > 0.0, True), ((times < 10.0) | (times > 13.0), False)):
        log = Log("record", DT, rest, rest, times[kept], walk[kept], times, rest, none, 0.0)
        found = base_noise([Track(log)], [rest], (0.0, 0.0), [])
        assert (found["localisation.rate"].value > 0.0) is jumps
        assert found["base_noise.linear"].value == pytest.approx(1e-3 / DT, rel=0.1)


def test_pattern_stays_within_limits_and_returns(solver):
    robot, home = solver.robot, solver.robot.home["home"]
    base = base_pattern(robot, DT)
    assert np.abs(base).max() <= 1.0
    np.testing.assert_allclose(base.sum(axis=0), 0.0, atol=1e-9)
    ways = arm_pattern(DT)[:, np.newaxis] * arm_amplitude(solver, home, DT)
    joints = home + ways
    lower, upper = robot.joint_limits
    assert np.all((joints >= lower) & (joints <= upper))
    assert not self_collides(solver.collision, joints[::3]).any()
    assert np.all(np.abs(np.diff(ways, axis=0)) <= 0.5 * robot.max_joint_velocity * DT)
    assert np.ptp(ways, axis=0).max() > 0.1


def test_record_is_of_what_adapters_were_given(record, hsr):
    """Behind the noise of the adapters, commands at rest would not be zero."""
    log = log_of(read_record(record), hsr, "record")
    assert not log.twists[:190].any()
    assert np.unique(np.round(np.abs(log.twists[220:300, 2]), 6)).tolist() == [0.6]


def test_jumps_of_the_localisation_do_not_set_the_scale_of_the_picture():
    moved = np.full((1000, 3), 0.2)
    measured = moved.copy()
    measured[::250] += 5.0
    figure = velocities_figure(
        Mock(times=[np.arange(1000)], measured=[measured], predicted=[moved])
    )
    assert [axes.get_ylim()[1] for axes in figure.axes] == pytest.approx([0.3] * 3)


def test_late_control_periods_are_reported(record, hsr, caplog):
    run = read_record(record)
    log_of(run, hsr, "on time")
    log_of(replace(run, time=run.time * 1.2), hsr, "late")
    assert [entry.args[0] for entry in caplog.records] == ["late"]


@pytest.mark.parametrize(("change", "named"), [
    (lambda r: replace(r, base_twist=r.base_twist * 0.0,
                       joint_targets=np.repeat(r.joint_targets[:1], len(r.time), axis=0)),
     "neither base nor arm moves"),
    (lambda r: replace(r, about=replace(r.about, joints=("a",) * 5)), "its joints"),
    (lambda r: replace(r, base_pose=r.base_pose * np.nan), "not finite"),
    (lambda r: replace(r, time=r.time * 0.01), "shorter"),
    *((lambda r, jump=jump: replace(r, time=r.time + jump * (r.time > 20.0)), "clock.* 20.0")
      for jump in (-10.0, 1e4)),
])  # fmt: skip
def test_records_that_show_nothing_raise(record, hsr, monkeypatch, change, named):
    changed = change(read_record(record))
    monkeypatch.setattr("kinfeas.api.identify.read_record", lambda path: changed)
    with pytest.raises(KinfeasError, match=named):
        identify("run.csv", "hsr")
