"""Settings of a training run: the schema of the sections `train`."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas.config import PluginSpec, Settings, from_mapping, merged, nested
from kinfeas.config.quantities import (
    Count,
    Episodes,
    NotNegative,
    Positive,
    PositiveShare,
    Processes,
    Seed,
    Share,
)
from kinfeas.config.recipes import read_recipe, section
from kinfeas.control.observation import OBSERVATION, check_terms
from kinfeas.envs.world import WorldConfig


@dataclass(frozen=True)
class LearnerConfig:
    """Hyperparameters of SAC.

    Attributes:
        learning_rate: Of actor and critics.
        schedule: Constant learning rate, or one that falls linearly to 0 over the run.
        batch_size: Transitions in a gradient step.
        gradient_steps: Gradient steps for each action of all environments.
        policy_delay: Gradient steps of the critics for each one of the actor.
        gamma: Discount of a reward one step later.
        tau: Share of the critics that the target networks take over in a gradient step.
        buffer_size: Transitions in the replay buffer.
        learning_starts: Steps of random actions, over all environments, before learning begins;
            with `init` these actions are the policy's, with noise.
        critic_steps: With `init`, steps after these in which only the critics learn.
        net_arch: Units of each hidden layer.
        anchor: With `init`, factor on the squared difference between the actions of the actor
            and of the initial policy, in the actor's loss. Of a policy without the terms of the
            surroundings, it counts where these are 0: no base is planned, nothing in range.
        ent_coef: Fixed entropy coefficient, or `learned`.
    """

    learning_rate: PositiveShare = 6e-4
    schedule: Literal["constant", "linear"] = "linear"
    batch_size: Annotated[int, Interval(ge=1, le=65_536)] = 256
    gradient_steps: Annotated[int, Interval(ge=1, le=10_000)] = 1
    policy_delay: Annotated[int, Interval(ge=1, le=100)] = 1
    gamma: Share = 0.99
    tau: Share = 0.005
    buffer_size: Annotated[int, Interval(ge=1, le=10_000_000)] = 1_000_000
    learning_starts: Annotated[int, Interval(ge=0)] = 3_000
    critic_steps: Annotated[int, Interval(ge=0)] = 0
    net_arch: tuple[Annotated[int, Interval(ge=1, le=2048)], ...] = (256, 256)
    ent_coef: NotNegative | Literal["learned"] = 0.01
    anchor: NotNegative = 0.0


@dataclass(frozen=True)
class ScheduleConfig:
    """Length of a run, its evaluations and its checkpoints.

    Attributes:
        steps: Environment steps in all; null for no limit.
        minutes: Wall-clock time of training; null for no limit. With physics it includes start and
            evaluations, in the analytic world it does not. At least one of the two is set, and the
            run ends at whichever comes first.
        evaluations: Number of evaluations, spread evenly over the run; the last one ends it.
        evaluation_episodes: Episodes of each evaluation. With physics and `minutes`, evaluations
            have fewer episodes, or are left out, where they would take more than a quarter of it.
        final_episodes: Fresh episodes on which the best policy is evaluated at the end; fewer, as
            above.
        checkpoint_seconds: Time between checkpoints to resume from.
        analytic: Share of the run at its beginning in the analytic world, with robots that respond
            at once; for runs without `init`, with physics or with adapters that make robots late.
    """

    steps: Count | None = None
    minutes: Positive | None = 3.0
    evaluations: Annotated[int, Interval(ge=1, le=10_000)] = 3
    evaluation_episodes: Episodes = 256
    final_episodes: Episodes = 256
    checkpoint_seconds: Positive = 30.0
    analytic: Share = 0.8

    def __post_init__(self) -> None:
        """Check that the run ends."""
        if self.steps is None and self.minutes is None:
            raise ValueError("one of 'steps' and 'minutes' must be set")


@dataclass(frozen=True)
class TrainConfig:
    """A training run.

    Attributes:
        robot: Name or folder of the robot.
        task: Entry-point name or YAML file of the task to learn.
        task_parameters: Keyword parameters of the task.
        seed: Of all randomness.
        num_envs: Episodes side by side.
        processes: With physics, processes that share the environments; the analytic world has one.
        action_repeat: Control periods of an action while learning, for exploration over longer
            times and a longer horizon. In an evaluation and on a robot each period has its own
            action.
        observation: Observation terms of the policy, in order.
        world: Control period, limits of an episode, adapters, reward and IK.
        evaluation_adapters: Adapters of the evaluations, which select and measure the best policy,
            in place of those of `world`, which may be there for exploration only.
        trackers: Where the curves of a run are shown, beside `metrics.csv`; `wandb` is an extra.
        init: Policy to start from: a run, a checkpoint or `pretrained`; null for none. It sets
            `learner.net_arch` and the first terms of `observation`; others have no effect at first.
        learner: Hyperparameters.
        schedule: Length, evaluations and checkpoints.
    """

    robot: str = "pr2"
    task: str = "ggr"
    task_parameters: dict[str, object] = field(default_factory=dict)
    seed: Seed = 0
    num_envs: Annotated[int, Interval(ge=1, le=65_536)] = 256
    processes: Processes = 1
    action_repeat: Annotated[int, Interval(ge=1, le=1000)] = 1
    observation: tuple[str, ...] = OBSERVATION
    world: WorldConfig = field(default_factory=WorldConfig)
    evaluation_adapters: tuple[PluginSpec, ...] = ()
    trackers: tuple[Literal["tensorboard", "wandb"], ...] = ("tensorboard",)
    init: str | None = None
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)

    def __post_init__(self) -> None:
        """Check that each process has an environment, and the names of the terms."""
        if self.processes > self.num_envs:
            raise ValueError(
                f"'processes' must be at most 'num_envs', {self.num_envs}, not {self.processes}"
            )
        check_terms(self.observation, "'observation'")


def load_recipe(
    name: str | None,
    settings: Settings | None = None,
    *,
    backend: str = "analytic",
    robot: str = TrainConfig.robot,
) -> TrainConfig:
    """Return the recipe of a training.

    Args:
        name: Recipe as in `read_recipe`; None for the robot's own. Keys that it lacks are those of
            the section of the robot that it names, by default of `train`, or in worlds with physics
            of `train_physics`, or of `finetune_physics` with `init`.
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
