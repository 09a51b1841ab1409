from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.config.recipes import recipes
from kinfeas.control.adapters import chain, execution_of, read_sim2real, wrap
from kinfeas.control.execution import ExecutionConfig
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import PolicyInput
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.ggr import ggr

LADDER = ("ideal", "paper", "pr2_like", "harsh")


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


def test_the_ladder_is_what_is_shipped():
    assert recipes("sim2real") == sorted(f"sim2real/{name}" for name in LADDER)


@pytest.mark.parametrize("name", LADDER)
def test_each_rung_suits_any_robot(name):
    for robot in ("pr2", "tiago", "hsr"):
        backend = wrap(AnalyticBackend(), read_sim2real(name).adapters, load_robot(robot))
        assert len(list(chain(backend))) == 1 + len(read_sim2real(name).adapters)
        assert isinstance(list(chain(backend))[-1], AnalyticBackend)


def test_pr2_like_has_the_accelerations_of_pr2(pr2):
    limits = next(a for a in read_sim2real("pr2_like").adapters if a.name == "acceleration_limit")
    assert limits.parameters["linear"] == pr2.base.max_acceleration
    assert limits.parameters["angular"] == pr2.base.max_rotation_acceleration


def test_a_list_of_ones_own_goes_by_its_path(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("adapters: [{name: base_noise, parameters: {linear: [0.1, 0.2]}}]")
    adapters = read_sim2real(str(path)).adapters
    assert adapters == (PluginSpec("base_noise", {"linear": [0.1, 0.2]}),)
    path.write_text("adapter: []")
    with pytest.raises(KinfeasError, match="did you mean 'adapters'"):
        read_sim2real(str(path))


def test_an_unknown_list_is_one_sentence():
    with pytest.raises(KinfeasError, match=r"'hars'.*did you mean 'harsh'.*or a file"):
        read_sim2real("hars")


@pytest.mark.parametrize("name", ["nope", "sim2real/paper"])
def test_an_unknown_list_names_those_that_can_be_typed(name):
    with pytest.raises(KinfeasError, match=rf"^unknown configuration '{name}'") as caught:
        read_sim2real(name)
    assert "known are harsh, ideal, paper, pr2_like, or a file" in str(caught.value)


@pytest.mark.parametrize("text", ["", "null", "{}", "# nothing"])
def test_an_empty_list_of_ones_own_must_say_so(tmp_path, text):
    path = tmp_path / "empty.yaml"
    path.write_text(text)
    with pytest.raises(
        KinfeasError, match=r"empty.yaml: must hold a list 'adapters', which is \[\]"
    ):
        read_sim2real(str(path))
    path.write_text("adapters: []")
    assert read_sim2real(str(path)).adapters == ()


def test_a_file_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for name in ("./nope.yaml", "nope.yml", "mine/nope", "../nope", str(tmp_path / "nope")):
        with pytest.raises(KinfeasError, match=rf"^{name}: there is no such file; known by name"):
            read_sim2real(name)
    for name in ("folder", "./folder", str(tmp_path)):
        with pytest.raises(KinfeasError, match=rf"^{name}: is a folder; known by name are harsh, "):
            read_sim2real(name)


@pytest.mark.parametrize("name", ["backend", "robot"])
def test_backend_and_robot_of_an_adapter_cannot_be_set(robot, name):
    with pytest.raises(KinfeasError, match=f"'base_noise' sets {name}"):
        wrap(None, [PluginSpec("base_noise", {name: 1})], robot)


def test_wrong_adapters_are_one_sentence(pr2):
    with pytest.raises(KinfeasError, match="did you mean 'base_noise'"):
        wrap(AnalyticBackend(), [PluginSpec("base_nose")], pr2)


class ExecutionChanger:
    """A backend around a backend that answers what a test says."""

    answer = None

    def __init__(self, backend, robot):
        self.backend = backend

    def execution(self, execution):
        return self.answer(execution)

    def reset(self, *arguments):
        return self.backend.reset(*arguments)

    def step(self, *arguments):
        return self.backend.step(*arguments)

    def close(self):
        self.backend.close()


def lost(execution):
    raise KeyError("execution")


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (
            lambda execution: None,
            "^adapter ExecutionChanger must return an ExecutionConfig",
        ),
        (lost, "^adapter ExecutionChanger fails in execution: KeyError: 'execution'"),
        (
            lambda execution: replace(execution, head_start=np.nan),
            "^head_start must be a number >= 0 in all, n",
        ),
        (
            lambda execution: replace(execution, arm_settle_timeout=-1.0),
            "^arm_settle_timeout must be a number >= 0 in all, not -1$",
        ),
    ],
)
def test_a_pace_that_is_none_is_one_sentence(pr2, monkeypatch, answer, sentence):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    monkeypatch.setattr(ExecutionChanger, "answer", staticmethod(answer))
    registry.register("kinfeas.adapters", "pacer", ExecutionChanger)
    with pytest.raises(KinfeasError, match=sentence):
        execution_of(wrap(AnalyticBackend(), [PluginSpec("pacer")], pr2), ExecutionConfig())


def test_the_pace_of_an_adapter_from_outside_counts_once(pr2, monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    twice = staticmethod(lambda execution: replace(execution, slow_down=2.0 * execution.slow_down))
    monkeypatch.setattr(ExecutionChanger, "answer", twice)
    registry.register("kinfeas.adapters", "pacer", ExecutionChanger)
    backend = wrap(AnalyticBackend(), [PluginSpec("pacer"), PluginSpec("head_start")], pr2)
    assert execution_of(backend, ExecutionConfig()) == ExecutionConfig(
        slow_down=2.0, head_start=3.0
    )


def test_the_first_one_is_innermost_and_a_backend_alone_has_its_pace(pr2):
    names = ("base_noise", "command_latency", "head_start")
    backend = wrap(AnalyticBackend(), [PluginSpec(name) for name in names], pr2)
    kinds = [type(link).__name__ for link in chain(backend)]
    assert kinds == ["HeadStart", "CommandLatency", "BaseNoise", "AnalyticBackend"]
    assert execution_of(backend, ExecutionConfig()) == ExecutionConfig(head_start=3.0)
    assert execution_of(AnalyticBackend(), ExecutionConfig(slow_down=2.0)) == ExecutionConfig(
        slow_down=2.0
    )


class Named(AnalyticBackend):
    """A backend that calls something of its own `backend`."""

    backend = "CUDA"


def test_a_backend_is_no_wrapper_for_an_attribute_of_that_name(pr2, monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    monkeypatch.setattr(
        ExecutionChanger,
        "answer",
        staticmethod(lambda execution: replace(execution, head_start=1.0)),
    )
    registry.register("kinfeas.adapters", "pacer", ExecutionChanger)
    innermost = Named()
    assert list(chain(innermost)) == [innermost]
    assert execution_of(innermost, ExecutionConfig()) == ExecutionConfig()
    backend = wrap(innermost, [PluginSpec("pacer"), PluginSpec("base_noise")], pr2)
    kinds = [type(link).__name__ for link in chain(backend)]
    assert kinds == ["BaseNoise", "CheckedAdapter", "ExecutionChanger", "Named"]
    assert execution_of(backend, ExecutionConfig()) == ExecutionConfig(head_start=1.0)


class Sway:
    """Drives to and fro, by what it sees."""

    def act(self, policy_input: PolicyInput):
        return np.sin(40.0 * policy_input.observation[:, :3])


def trace(world, episodes, steps):
    world.start(episodes)
    seen = []
    for _ in range(steps):
        transition = world.step(Sway().act(world.loop.policy_input))
        seen.append(np.column_stack([transition.observation, transition.step.deviation]))
    return np.stack(seen)


@pytest.mark.parametrize("name", ["pr2_like", "harsh"])
@pytest.mark.parametrize("dt", [0.1, 0.02])
def test_episodes_are_the_same_to_the_bit_in_any_batch(pr2, name, dt):
    config = WorldConfig(dt=dt, adapters=read_sim2real(name).adapters)
    together = trace(World(pr2, ggr(), config, seed=3), range(6), 40)
    alone = trace(World(pr2, ggr(), config, seed=3), [4], 40)
    np.testing.assert_array_equal(alone[:, 0], together[:, 4])


@pytest.mark.parametrize("name", ["pr2_like", "harsh"])
def test_a_run_goes_on_to_the_bit(pr2, name):
    config = WorldConfig(adapters=read_sim2real(name).adapters)
    world, other = (World(pr2, ggr(), config, seed=3) for _ in "ab")
    trace(world, range(4), 30)
    other.restore(world.snapshot())
    for _ in range(30):
        one, two = (each.step(Sway().act(each.loop.policy_input)) for each in (world, other))
        np.testing.assert_array_equal(one.observation, two.observation)
        np.testing.assert_array_equal(one.step.deviation, two.step.deviation)
        np.testing.assert_array_equal(one.done, two.done)


def test_what_is_seen_is_measured_and_the_deviation_is_true(pr2):
    config = WorldConfig(adapters=(PluginSpec("localisation", {"rate": 50.0, "jump": 0.3}),))
    world = World(pr2, ggr(), config, seed=0)
    plain = World(pr2, ggr(), WorldConfig(), seed=0)
    for each in (world, plain):
        each.start(range(20))
    for _ in range(5):
        step = world.step(np.zeros((20, 3))).step
    assert step.goal_distance == pytest.approx(
        np.linalg.norm((world.loop.ee_pose - world.loop.goal)[:, :3], axis=1)
    )
    seen_off = np.linalg.norm((world.loop.ee_pose - world.loop.desired)[:, :3], axis=1)
    # The arm makes up for a base that it believes elsewhere: it seems right and is wrong.
    assert np.median(step.deviation) > 0.1
    assert not np.allclose(seen_off, step.deviation)
