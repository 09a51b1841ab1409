"""Settings of a training run: the schema of the sections `train`."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas.config import PluginSpec, Settings, from_mapping, merged, nested
from kinfeas.config.recipes import read_recipe, section
from kinfeas.control.observation import OBSERVATION, check_terms
from kinfeas.core.quantities import (
    Count,
    Episodes,
    Fraction,
    NotNegative,
    Positive,
    PositiveFraction,
    Processes,
    Seed,
)
from kinfeas.envs.world import WorldConfig


@dataclass(frozen=True)
class LearnerConfig:
    """Hyperparameters of SAC."""

    learning_rate: PositiveFraction = 6e-4  # of actor and critics
    # constant learning rate, or one that falls linearly to 0 over the run
    schedule: Literal["constant", "linear"] = "linear"
    batch_size: Annotated[int, Interval(ge=1, le=65_536)] = 256  # transitions in a gradient step
    # gradient steps for each action of all environments
    gradient_steps: Annotated[int, Interval(ge=1, le=10_000)] = 1
    # gradient steps of the critics for each one of the actor
    policy_delay: Annotated[int, Interval(ge=1, le=100)] = 1
    gamma: Fraction = 0.99  # discount of a reward one step later
    tau: Fraction = 0.005  # fraction by which target networks approach the critics in a step
    # transitions in the replay buffer
    buffer_size: Annotated[int, Interval(ge=1, le=10_000_000)] = 1_000_000
    # steps of random actions, over all environments, before learning begins; with `init` these
    # actions are the policy's, with noise
    learning_starts: Annotated[int, Interval(ge=0)] = 3_000
    # with `init`, steps after `learning_starts` in which only the critics learn
    critic_steps: Annotated[int, Interval(ge=0)] = 0
    # units of each hidden layer
    net_arch: tuple[Annotated[int, Interval(ge=1, le=2048)], ...] = (256, 256)
    ent_coef: NotNegative | Literal["learned"] = 0.01  # fixed entropy coefficient, or `learned`
    # with `init`, factor on the squared difference between the actions of the actor and of the
    # initial policy, in the actor's loss. If that policy lacks observation terms of the
    # surroundings, only where these are 0: without a planned base and without objects in range
    anchor: NotNegative = 0.0


@dataclass(frozen=True)
class ScheduleConfig:
    """Length of a run, its evaluations and its checkpoints."""

    steps: Count | None = None  # environment steps in all; null for no limit
    # wall-clock time of training; null for no limit. With physics it includes start and
    # evaluations, in the analytic world it does not. `steps`, `minutes` or both are set, and the
    # run ends at the first limit
    minutes: Positive | None = 3.0
    # number of evaluations, spread evenly over the run; the last one ends it
    evaluations: Annotated[int, Interval(ge=1, le=10_000)] = 3
    # episodes of each evaluation. With physics and `minutes`, evaluations have fewer episodes, or
    # are left out, where they would take more than a quarter of that time
    evaluation_episodes: Episodes = 256
    # fresh episodes on which the best policy is evaluated at the end; with physics and `minutes`
    # possibly fewer
    final_episodes: Episodes = 256
    checkpoint_seconds: Positive = 30.0  # time between checkpoints to resume from
    # fraction of the run, at its beginning, in the analytic world with robots that respond at once.
    # Applies to runs without `init` that have physics or adapters that make robots late
    analytic: Fraction = 0.8

    def __post_init__(self) -> None:
        """Check that the run ends."""
        if self.steps is None and self.minutes is None:
            raise ValueError("one of 'steps' and 'minutes' must be set")


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    robot: str = "pr2"  # name or folder of the robot
    task: str = "ggr"  # entry-point name or YAML file of the task to learn
    # keyword parameters of the task
    task_parameters: dict[str, object] = field(default_factory=dict)
    seed: Seed = 0  # of all randomness
    num_envs: Annotated[int, Interval(ge=1, le=65_536)] = 256  # number of parallel environments
    # with physics, processes that share the environments; the analytic world has one
    processes: Processes = 1
    # control periods for which an action is repeated while learning, for exploration over longer
    # times and a longer horizon. In an evaluation and on a robot each period has its own action
    action_repeat: Annotated[int, Interval(ge=1, le=1000)] = 1
    observation: tuple[str, ...] = OBSERVATION  # observation terms of the policy, in order
    # control period, limits of an episode, adapters, reward and IK
    world: WorldConfig = field(default_factory=WorldConfig)
    # adapters of the evaluations, which select and measure the best policy, in place of those of
    # `world`, which may be there for exploration only
    evaluation_adapters: tuple[PluginSpec, ...] = ()
    # where the curves of a run are shown, beside `metrics.csv`; `wandb` is an extra
    trackers: tuple[Literal["tensorboard", "wandb"], ...] = ("tensorboard",)
    # policy to start from: a run, a checkpoint or `pretrained`; null for none. It sets
    # `learner.net_arch` and the first terms of `observation`; additional ones begin without effect
    init: str | None = None
    learner: LearnerConfig = field(default_factory=LearnerConfig)  # hyperparameters
    # length, evaluations and checkpoints
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)

    def __post_init__(self) -> None:
        """Check that the policy learns, processes have environments, and the names of the terms."""
        steps, starts = self.schedule.steps, self.learner.learning_starts
        if self.init is None and steps is not None and steps <= starts:
            raise ValueError(f"'schedule.steps' must be above 'learner.learning_starts', {starts}")
        if self.processes > self.num_envs:
            raise ValueError(
                f"'processes' must be at most 'num_envs', {self.num_envs}, not {self.processes}"
            )
        check_terms(self.observation, "'observation'")


def duration(minutes: float | None, steps: int | None) -> dict[str, object]:
    """Return settings of the duration: if one limit is given, the recipe's other one is lifted."""
    if minutes is None and steps is None:
        return {}
    return {"schedule.minutes": minutes, "schedule.steps": steps}


def load_recipe(
    name: str | None,
    settings: Settings | None = None,
    *,
    backend: str = "analytic",
    robot: str = TrainConfig.robot,
) -> TrainConfig:
    """Return the recipe of a training.

    Args:
        name: Recipe as in `read_recipe`; None for the robot's own. The keys that it lacks come from
            the section of the robot that it names. By default that is `train`, in worlds with
            physics `train_physics`, or with `init` as well `finetune_physics`.
        settings: Values by key, as in `from_mapping`.
        backend: World of the training.
        robot: Robot where neither the settings nor the recipe name one.

    Raises:
        KinfeasError: If there is no such recipe or robot, or a key or value is wrong.
    """
    data, name_of_section = ({}, None) if name is None else read_recipe(name)
    changes = nested(settings)
    data = {"robot": robot, **data}
    robot_name, source = changes.get("robot", data["robot"]), name or ""
    if isinstance(robot_name, str):
        physical = "finetune_physics" if changes.get("init", data.get("init")) else "train_physics"
        kind = name_of_section or ("train" if backend == "analytic" else physical)
        base, origin = section(kind, robot_name)
        if backend != "analytic" and "backend" in base.get("world", {}):
            base = merged(base, {"world": {"backend": backend}})
            # MuJoCo steps a batch on all cores, and only a world in this process is saved.
            base |= {"processes": 1} if backend == "mujoco" else {}
        data, source = merged(base, data), source or origin
    return from_mapping(TrainConfig, data, source, changes)
