import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kinfeas
from kinfeas import api
from kinfeas.core.errors import KinfeasError
from tests.cli.conftest import TINY

SETTINGS = {key: json.loads(value) for key, _, value in (one.partition("=") for one in TINY[1::2])}
ROOT = Path(kinfeas.__file__).parent


def test_importing_the_package_imports_nothing_else():
    code = "import sys; sys.path.insert(0, sys.argv[1]); import kinfeas; print(*sys.modules)"
    command = [sys.executable, "-IS", "-c", code, str(ROOT.parent)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "kinfeas" in loaded
    assert not {"numpy", "typing", "kinfeas.api"} & loaded


def test_package_types_and_module_offer_the_same():
    stub = ast.parse((ROOT / "__init__.pyi").read_text())
    typed = {node.names[0].name for node in stub.body if isinstance(node, ast.ImportFrom)}
    assert set(kinfeas._API) == set(api.__all__) == typed
    for name in typed:
        assert getattr(kinfeas, name) is getattr(api, name)
    with pytest.raises(AttributeError):
        kinfeas.tran  # noqa: B018


def test_a_run_is_evaluated_exported_and_loaded(tmp_path):
    told = []
    run = kinfeas.train(
        "hsr", steps=64, out=tmp_path / "run", settings=SETTINGS, on_progress=told.append
    )
    assert run.steps == told[-1].steps >= 64
    assert run.figures == json.loads((run.folder / "evaluation.json").read_text())
    figures = kinfeas.evaluate(run.folder, episodes=2, settings={"world.max_seconds": 1})
    assert (figures["robot"], figures["episodes"]) == ("hsr", 2)
    about = kinfeas.export(run.folder, tmp_path / "hsr.onnx")
    assert about["file"] == "hsr.onnx"
    trained, exported = (kinfeas.load_policy(one) for one in (run.folder, tmp_path / "hsr.onnx"))
    seen = np.random.default_rng(0).normal(size=(3, len(trained.scale)))
    np.testing.assert_allclose(exported(seen), trained(seen), atol=1e-5)
    with pytest.raises(KinfeasError):
        kinfeas.train("hsr", out=run.folder)


def test_figures_are_those_of_the_command(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from kinfeas.cli.main import app

    path = tmp_path / "figures.json"
    names = ["--policy", "follow_ee", "--robot", "tiago", "--adapters", "ideal"]
    options = [
        "--episodes",
        "2",
        "--set",
        "world.max_seconds=1",
        "--rollout-planner",
        "--json",
        str(path),
    ]
    CliRunner().invoke(app, ["evaluate", *names, *options], catch_exceptions=False)
    figures = kinfeas.evaluate(
        "follow_ee",
        robot="tiago",
        adapters="ideal",
        episodes=2,
        rollout_planner=True,
        settings={"world.max_seconds": 1},
    )
    told = json.loads(path.read_text())
    assert figures == {key: told[key] for key in figures}


@pytest.mark.parametrize(
    "arguments",
    [
        {"policy": "folow_ee"},
        {"world": "real"},
        {"episodes": 0},
        {"settings": {"world.dtt": 1}},
        {"robot": "r2d2"},
    ],
)
def test_bad_input_is_an_error(arguments):
    with pytest.raises(KinfeasError):
        kinfeas.evaluate(**{"policy": "follow_ee", **arguments})
