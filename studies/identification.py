"""Identify simulated robots whose parameters are known, and count how many are found.

`python studies/identification.py DIR` draws robots from `harsh` in the analytic world, HSR, PR2 and
TIAGo in turn, drives the pattern of `kinfeas identify --drive` with each, fits its record, and
prints how far estimates are off and how often the intervals hold the truth. Each run is a CSV and a
JSON file in DIR; those that exist are not repeated. `--draws N` changes their number, `--first N`
the first seed. `--link N` adds as many draws of PR2 as a robot of `kinfeas simulate` in simulated
time, `--ros2 N` in real time over ROS 2, which needs two idle cores.
"""

import argparse
import json
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import simulated_link

from kinfeas.api.identify import drive, identify
from kinfeas.api.load import load_robot, read_adapters
from kinfeas.control.assemble import build_backend, with_adapters
from kinfeas.core.backend import BackendWrapper
from kinfeas.core.spatial import IDENTITY
from kinfeas.core.start import episode_rng
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.identify.model import arm_delay

ROBOTS = ("hsr", "pr2", "tiago")
ADAPTERS = "harsh"
TARGETS: dict[str, float | str] = {
    "actuator_lag.base": 0.015, "actuator_lag.arm": 0.015, "command_latency.seconds": 0.015,
    "sensor_latency.seconds": 0.015, "acceleration_limit.linear": "15 %",
    "acceleration_limit.angular": "15 %", "base_noise.linear": "30 %", "base_noise.angular": "30 %",
    "joint_noise.deviation": "30 %",
}  # fmt: skip
"""Largest accepted error of an estimate: seconds, or percent of the true value."""

PERIOD, STEP, ARM_SECONDS = 0.02, 0.01, 0.1
"""Control period, simulation step and duration of arm trajectories behind a bus, seconds."""

TRANSPORT = 0.01
"""Seconds until a simulated robot acts: half a step of 10 ms, 2 ms of computing and bus, and 3 ms
since it plans the motion of its arm anew in each step."""

Run = dict[str, Any]
"""Facts of a fit, and the truth."""


def main() -> None:
    """Run what is missing, then print what there is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--link", type=int, default=0)
    parser.add_argument("--ros2", type=int, default=0)
    options = parser.parse_args()
    folder = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for number in range(options.draws):
        robot, seed = ROBOTS[number % len(ROBOTS)], options.first + number
        runs.append(result_of(folder / f"{robot}-{seed}", robot, seed, "analytic"))
    if runs:
        report("analytic world", runs)
    for backend, count in (("link", options.link), ("ros2", options.ros2)):
        seeds = range(options.first, options.first + count)
        runs = [result_of(folder / f"{backend}-{seed}", "pr2", seed, backend) for seed in seeds]
        if runs:
            report(f"kinfeas simulate over {backend}", runs)


def result_of(path: Path, robot: str, seed: int, backend: str) -> Run:
    """Return truth, estimates and intervals of a draw; drive and fit it if files are missing."""
    record, result = path.with_suffix(".csv"), path.with_suffix(".json")
    if not record.exists():
        if backend == "analytic":
            run = drive(
                robot, backend=backend, record=record, adapters=ADAPTERS, seed=seed,
                real_time=False,
            )  # fmt: skip
            assert run.outcome.code == 0, run.outcome.reason
        elif backend == "link":
            simulated_link.drive(robot, ADAPTERS, seed, record, PERIOD, STEP)
        else:
            drive_over_ros2(robot, seed, record)
    if not result.exists():
        begin = time.perf_counter()
        facts: Run = identify(record).facts()
        facts["seconds"] = time.perf_counter() - begin
        facts["truth"] = truth(robot, seed)
        if backend != "analytic":
            facts["truth"] = over_a_bus(facts["truth"])
        result.write_text(json.dumps(facts, indent=2))
    return json.loads(result.read_text())


def drive_over_ros2(robot: str, seed: int, record: Path) -> None:
    """Record the pattern with a simulated robot behind ROS 2."""
    command = [sys.executable, "-m", "kinfeas"]
    words = ["--robot", robot, "--backend", "ros2"]
    simulated = subprocess.Popen(
        [*command, "simulate", *words, "--adapters", ADAPTERS, "--seed", str(seed)],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert simulated.stdout is not None
        simulated.stdout.readline()  # is ready
        subprocess.run(
            [*command, "identify", "--drive", *words, "--record", str(record)], check=True
        )
    finally:
        simulated.terminate()
        simulated.wait()


def truth(robot: str, seed: int) -> dict[str, float]:
    """Return the drawn parameters of the adapters, by adapter and parameter."""
    model, specs = load_robot(robot), read_adapters(ADAPTERS)
    backend = with_adapters(build_backend("analytic", {}), specs, model)
    seeds = np.array([episode_rng(seed, 0).integers(2**64, dtype=np.uint64)])
    backend.seed(seeds, np.array([0]))
    backend.reset(IDENTITY[np.newaxis], model.home["home"][np.newaxis])
    numbers: dict[str, float] = {}
    for name in [spec.name for spec in reversed(specs)]:
        assert isinstance(backend, BackendWrapper)
        if isinstance(backend, Adapter):
            numbers |= {f"{name}.{key}": float(backend.number(key)[0, 0]) for key in backend.ranges}
        backend = backend.backend
    return numbers


def over_a_bus(true: dict[str, float]) -> dict[str, float]:
    """Return the parameters that a record of a simulated robot behind a bus shows, from drawn ones.

    A simulated robot takes commands at its own steps, and adapters draw their noise in each of
    them. The constant part of a sensor latency looks like a command latency.
    """
    late = true["sensor_latency.seconds"] + TRANSPORT
    changed = {
        "command_latency.seconds": true["command_latency.seconds"] + late,
        "actuator_lag.arm": true["actuator_lag.arm"] + arm_delay(PERIOD, ARM_SECONDS),
    }
    for name in ("base_noise.linear", "base_noise.angular"):
        changed[name] = true[name] * np.sqrt(STEP / PERIOD)
    hidden = ("sensor_latency.seconds", "sensor_latency.jitter")
    return {name: value for name, value in (true | changed).items() if name not in hidden}


def report(title: str, runs: list[Run]) -> None:
    """Print a table of estimates against the truth."""
    errors, held, within = defaultdict(list), defaultdict(list), defaultdict(list)
    for run in runs:
        for name, true in run["truth"].items():
            estimate = run["estimates"].get(name)
            if estimate is None:
                if name in TARGETS:
                    within[name].append(False)
                continue
            errors[name].append(estimate["value"] - true)
            held[name].append(estimate["low"] <= true <= estimate["high"])
            if name in TARGETS:
                limit = TARGETS[name]
                most = limit if isinstance(limit, float) else float(limit.split()[0]) / 100 * true
                within[name].append(abs(estimate["value"] - true) <= most)
    seconds = np.mean([run["seconds"] for run in runs])
    print(f"{title}: {len(runs)} draws, {seconds:.1f} s a fit\n")
    print("| parameter | mean error | largest | within | of | interval holds the truth |")
    print("|---|---|---|---|---|---|")
    for name, differences in errors.items():
        enough = f"{sum(within[name])} of {len(within[name])}" if name in TARGETS else "-"
        limit = TARGETS.get(name, "-")
        mean, most = np.mean(np.abs(differences)), np.max(np.abs(differences))
        text = f"{1000 * limit:.0f} ms" if isinstance(limit, float) else limit
        print(
            f"| `{name}` | {mean:.3g} | {most:.3g} | {text} "
            f"| {enough} | {sum(held[name])} of {len(held[name])} |"
        )
    fraction = np.mean([flag for name in TARGETS for flag in held[name]])
    print(f"\nintervals of the parameters with a target hold the truth in {fraction:.0%}\n")


if __name__ == "__main__":
    main()
