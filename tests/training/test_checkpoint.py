import ast
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World
from kinfeas.policies.network import read_network
from kinfeas.robots.loading import load_robot
from kinfeas.training.checkpoint import load_learner, save_learner
from kinfeas.training.learner import explore, make_learner
from kinfeas.training.state import read_state
from kinfeas.training.train import resume, train
from kinfeas.training.vec_env import WorldVecEnv

ROOT = Path(__file__).parents[2]
ADAPTERS = "[{name: base_noise}, {name: command_latency}, {name: sensor_latency}]"
LEARNERS = [(), ("learner.ent_coef=learned",), ("learner.algorithm=td3",)]


class Toy:
    """A learner and its environments, that learn without train.py."""

    def __init__(self, config, robot="pr2"):
        task = registry.build("kinfeas.tasks", "ggr", {})
        self.config = config.learner
        self.env = WorldVecEnv(World(load_robot(robot), task, config.world, 1), 4)
        self.learner = make_learner(config.learner, self.env, 0)
        self.seen = self.env.reset()

    def learn(self, steps):
        for _ in range(steps):
            action = explore(self.learner, self.config, self.seen, random=False)
            seen, rewards, dones, infos = self.env.step(action)
            after = seen.copy()
            for row in np.flatnonzero(dones):
                after[row] = infos[row]["terminal_observation"]
            self.learner.replay_buffer.add(self.seen, after, action, rewards, dones, infos)
            self.seen = seen
            self.learner.train(2, 16)

    def save(self, folder, state=None):
        folder.mkdir()
        save_learner(folder, self.learner, self.env.snapshot(), state or {})

    def load(self, folder):
        self.seen = self.env.restore(load_learner(folder, self.learner, self.env.snapshot()))


@pytest.fixture(params=LEARNERS, ids=["sac", "sac with learned entropy", "td3"])
def config(request, tiny):
    return tiny("learner.buffer_size=100", *request.param)


@pytest.mark.parametrize("steps", [3, 40], ids=["buffer not full", "buffer full"])
def test_goes_on_from_a_checkpoint_to_the_bit(config, tmp_path, steps):
    toy = Toy(config)
    toy.learn(steps)
    assert toy.learner.replay_buffer.full == (steps == 40)
    toy.save(tmp_path / "a", {"progress": {"steps": 3}})
    toy.learn(9)
    toy.save(tmp_path / "expected")
    other = Toy(config)
    other.learn(2)  # whatever it was before
    other.load(tmp_path / "a")
    assert read_state(tmp_path / "a")["progress"] == {"steps": 3}
    other.learn(9)
    other.save(tmp_path / "found")
    expected, found = (load_file(tmp_path / n / "state.safetensors") for n in ("expected", "found"))
    assert expected.keys() == found.keys()
    for key, values in expected.items():
        assert torch.equal(values, found[key]), key
    texts = [(tmp_path / n / "state.json").read_text() for n in ("expected", "found")]
    assert texts[0] == texts[1]


@pytest.mark.parametrize("seed", range(6))
def test_any_tensor_of_another_form_is_a_clear_error(tiny, tmp_path, seed):
    """Each is dropped, cut, stretched, of another type, of another rank or of another name."""
    config = tiny("learner.ent_coef=learned", f"world.adapters={ADAPTERS}")
    toy, other, rng = Toy(config), Toy(config), np.random.default_rng(seed)
    toy.learn(3)
    toy.save(tmp_path / "a")
    changes = [
        lambda t: None,
        lambda t: t.reshape(-1)[: t.numel() - 1],
        lambda t: torch.cat([t.reshape(1, *t.shape)] * 2),
        lambda t: t.to(torch.float64 if t.dtype != torch.float64 else torch.float32),
        lambda t: t.to(torch.int32),
        lambda t: t[:, :0] if t.dim() > 1 else t[..., None],
    ]
    tensors = load_file(tmp_path / "a" / "state.safetensors")
    for key in rng.permutation(sorted(tensors))[:25]:
        changed = dict(tensors)
        made = changes[rng.integers(len(changes))](changed.pop(key))
        name = key if rng.random() < 0.8 else f"{key}x"
        if made is not None:
            changed[name] = made.contiguous()
        save_file(changed, tmp_path / "a" / "state.safetensors")
        with pytest.raises(KinfeasError, match="a: broken checkpoint, or one of another run"):
            other.load(tmp_path / "a")
    save_file(tensors, tmp_path / "a" / "state.safetensors")
    other.load(tmp_path / "a")


def test_a_snapshot_may_hold_motions_that_begin_later(tiny, tmp_path):
    toy = Toy(tiny())
    saved = {**toy.env.snapshot(), "motion.1.goal": np.zeros((4, 7))}
    (tmp_path / "a").mkdir()
    save_learner(tmp_path / "a", toy.learner, saved, {})
    assert load_learner(tmp_path / "a", toy.learner, toy.env.snapshot()).keys() == saved.keys()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("format", 7), ("optimizers", []), ("optimizers", {}), ("updates", "many"),
        ("buffer", {"position": 5, "full": False}), ("random", {}), ("random", "none"),
        ("updates", float("inf")), ("updates", 1.5), ("updates", -1), ("updates", None),
        ("buffer", {"position": float("inf"), "full": False}),
        ("buffer", {"position": float("nan"), "full": False}),
        ("buffer", {"position": 3, "full": "no"}), ("buffer", {"position": -1, "full": True}),
        ("buffer", {"position": 10**9, "full": True}), ("buffer", [3, False]),
    ],
)  # fmt: skip
def test_a_foreign_number_is_a_clear_error(tiny, tmp_path, key, value):
    toy = Toy(tiny())
    toy.learn(3)
    toy.save(tmp_path / "a")
    path = tmp_path / "a" / "state.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(KinfeasError, match="a: broken checkpoint, or one of another run"):
        Toy(tiny()).load(tmp_path / "a")


def test_an_error_is_one_short_line(tiny, tmp_path):
    toy = Toy(tiny())
    toy.save(tmp_path / "a")
    with pytest.raises(KinfeasError) as caught:
        Toy(tiny("learner.net_arch=[8]")).load(tmp_path / "a")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_another_robots_checkpoint_is_a_clear_error(tiny, tmp_path):
    Toy(tiny(), "hsr").save(tmp_path / "a")
    with pytest.raises(KinfeasError, match="one of another run"):
        Toy(tiny(), "tiago").load(tmp_path / "a")


def test_no_checkpoint_is_a_clear_error(tiny, tmp_path):
    with pytest.raises(KinfeasError, match="nothing: no checkpoint to resume"):
        Toy(tiny()).load(tmp_path / "nothing")


@pytest.fixture(scope="module")
def run(tiny, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    train(tiny("schedule.steps=640", "schedule.evaluations=1"), out)
    return out


@pytest.mark.parametrize("place", [".", "checkpoints/best", "checkpoints/last"])
def test_a_run_and_its_checkpoints_are_policies(run, place):
    assert read_network(run / place, load_robot("pr2")).weights[0].shape == (28, 16)


def test_the_policy_of_another_robot_is_a_clear_error(run):
    with pytest.raises(KinfeasError, match=r"a policy for robot 'pr2' .* but robot 'hsr' has"):
        read_network(run, load_robot("hsr"))


def test_a_truncated_or_foreign_policy_is_a_clear_error(run, tmp_path):
    best, robot = run / "checkpoints" / "best", load_robot("pr2")
    contents = {path.name: path.read_bytes() for path in best.iterdir()}
    assert set(contents) == {"policy.json", "policy.safetensors"}
    for name, content in contents.items():
        for other in (b"", content[: len(content) // 2], content[:-3], b"[]", b"{}", None):
            for path, whole in contents.items():
                (tmp_path / path).write_bytes(whole)
            (tmp_path / name).unlink() if other is None else (tmp_path / name).write_bytes(other)
            with pytest.raises(KinfeasError, match=r"broken|not a training run|must|missing"):
                read_network(tmp_path, robot)


def test_truncation_is_bootstrapped(run):
    """The end of time is no terminal state: SB3 multiplies `dones` by what is no timeout."""
    tensors = load_file(run / "checkpoints" / "last" / "state.safetensors")
    dones, timeouts = (tensors[f"buffer.{name}"].numpy() for name in ("dones", "timeouts"))
    assert 0 < timeouts.sum() < dones.sum()
    assert (dones >= timeouts).all()
    before, after = (tensors[f"buffer.{n}"].numpy() for n in ("observations", "next_observations"))
    goes_on = dones[:-1] == 0.0
    np.testing.assert_array_equal(after[:-1][goes_on], before[1:][goes_on])
    assert (np.abs(after[:-1] - before[1:]).max(axis=-1)[~goes_on] > 1e-3).all()


def test_resuming_unpickles_nothing(run, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("unpickled")

    for owner, name in (
        (pickle, "load"),
        (pickle, "loads"),
        (pickle, "Unpickler"),
        (torch, "load"),
    ):
        monkeypatch.setattr(owner, name, refuse)
    assert resume(run).steps == 640
    read_network(run, load_robot("pr2"))


FORBIDDEN = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
OWN = [
    path
    for folder in ("kinfeas", "plugins", "scenes", "sim2real", "configs")
    for path in sorted((ROOT / folder).rglob("*.py"))
]


@pytest.mark.parametrize("path", OWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_module_can_unpickle_or_evaluate(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not FORBIDDEN & {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert (node.module or "").split(".")[0] not in FORBIDDEN
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {
                "torch.load",
                "eval",
                "exec",
                "yaml.unsafe_load",
                "yaml.full_load",
            }
            assert called.rpartition(".")[0] not in {"SAC", "TD3"} or not called.endswith(".load")
            allowed = [k for k in node.keywords if k.arg == "allow_pickle"]
            assert all(isinstance(k.value, ast.Constant) and not k.value.value for k in allowed)
