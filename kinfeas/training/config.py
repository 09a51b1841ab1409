"""What a training run is made of: the schema of the sections `train` of `configs/robots`."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from kinfeas.config import Interval
from kinfeas.config.quantities import (
    LAST_SEED,
    MOST_PROCESSES,
    Count,
    Episodes,
    NotNegative,
    Positive,
    PositiveShare,
    Share,
)
from kinfeas.envs.physics import PhysicsChanges
from kinfeas.envs.world import WorldConfig

MOST_LAYERS, MOST_TRANSITIONS = 8, 65_536


@dataclass(frozen=True)
class LearnerConfig:
    """Hyperparameters of SAC and TD3.

    Attributes:
        algorithm: `sac` or `td3`.
        learning_rate: Of actor and critics.
        schedule: Whether the learning rate stays, or falls linearly to 0 over the run.
        batch_size: Transitions in a gradient step.
        gradient_steps: Gradient steps for each action of all environments.
        gamma: Worth of a reward one step later.
        tau: Share tau that the target networks take over in a gradient step.
        buffer_size: Transitions kept for replay.
        learning_starts: Steps of random actions, over all environments, before learning begins; a
            run that goes on from a policy takes the policy's, with noise.
        critic_steps: Steps after these in which the critics learn and the actor stays as it is.
        net_arch: Units of each hidden layer.
        anchor: SAC, with `init`: factor on the squared difference between the actions of the actor
            and of the policy that it goes on from, in the actor's loss.
        ent_coef: SAC: fixed entropy coefficient, or `learned`.
        exploration_noise: TD3: standard deviation of the noise on actions.
        policy_noise: TD3: standard deviation of the target policy's noise.
    """

    algorithm: Literal["sac", "td3"] = "sac"
    learning_rate: PositiveShare = 6e-4
    schedule: Literal["constant", "linear"] = "linear"
    batch_size: Count = 256
    gradient_steps: Annotated[int, Interval(low=1, high=10_000)] = 1
    gamma: Share = 0.99
    tau: Share = 0.005
    buffer_size: Annotated[int, Interval(low=1, high=10_000_000)] = 1_000_000
    learning_starts: Annotated[int, Interval(low=0)] = 3_000
    critic_steps: Annotated[int, Interval(low=0)] = 0
    net_arch: tuple[Annotated[int, Interval(low=1, high=2048)], ...] = (256, 256)
    ent_coef: NotNegative | Literal["learned"] = 0.01
    anchor: NotNegative = 0.0
    exploration_noise: NotNegative = 0.25
    policy_noise: NotNegative = 0.2

    def __post_init__(self) -> None:
        """Check how much a gradient step takes in, and how deep the network is."""
        if self.batch_size > MOST_TRANSITIONS:
            raise ValueError(
                f"'batch_size' must be at most {MOST_TRANSITIONS}, not {self.batch_size}"
            )
        if len(self.net_arch) > MOST_LAYERS:
            raise ValueError(
                f"'net_arch' must have at most {MOST_LAYERS} entries, not {len(self.net_arch)}"
            )


@dataclass(frozen=True)
class ScheduleConfig:
    """How long a run lasts and what it does meanwhile.

    Attributes:
        steps: Environment steps in all; null for any number.
        minutes: Wall-clock time of training, evaluations not included; null for any time. At least
            one of the two is set, and the run ends at whichever comes first.
        evaluations: Evaluations, spread evenly over the run; the last one ends it.
        evaluation_episodes: Episodes of each evaluation.
        final_episodes: Fresh episodes on which the best policy is evaluated at the end.
        checkpoint_seconds: Time between checkpoints to resume from.
    """

    steps: Count | None = None
    minutes: Positive | None = 3.0
    evaluations: Annotated[int, Interval(low=1, high=10_000)] = 3
    evaluation_episodes: Episodes = 256
    final_episodes: Episodes = 256
    checkpoint_seconds: Positive = 30.0

    def __post_init__(self) -> None:
        """Check that the run has an end."""
        if self.steps is None and self.minutes is None:
            raise ValueError("one of 'steps' and 'minutes' must be set")


@dataclass(frozen=True)
class TrainConfig:
    """A training run.

    Attributes:
        robot: Name or YAML file of the robot.
        task: Entry-point name or YAML file of the task to learn.
        task_parameters: Keyword parameters of the task.
        seed: Of everything random.
        num_envs: Episodes side by side.
        processes: With physics, processes that share the environments; the analytic world has one.
        action_repeat: Control periods for which an action holds while learning: chance that lasts
            finds more of what a base can do, and the learner looks as many times farther ahead. In
            an evaluation and on a robot each period has an action of its own.
        world: Where they happen.
        physics: Null for the analytic world; else what is different in the PyBullet world.
        init: Policy to go on from: a run, a checkpoint or `pretrained`; null for none. It says
            what `learner.net_arch` is.
        learner: What learns from them.
        schedule: For how long.
    """

    robot: str = "pr2"
    task: str = "ggr"
    task_parameters: dict[str, object] = field(default_factory=dict)
    seed: Annotated[int, Interval(low=0)] = 0
    num_envs: Annotated[int, Interval(low=1, high=65_536)] = 256
    processes: Annotated[int, Interval(low=1, high=MOST_PROCESSES)] = 1
    action_repeat: Annotated[int, Interval(low=1, high=1000)] = 1
    world: WorldConfig = field(default_factory=WorldConfig)
    physics: PhysicsChanges | None = None
    init: str | None = None
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)

    def __post_init__(self) -> None:
        """Check the seed, and that each process has an environment."""
        if self.seed > LAST_SEED:
            raise ValueError(f"'seed' must be at most {LAST_SEED}, not {self.seed}")
        if self.processes > self.num_envs:
            raise ValueError(
                f"'processes' must be at most 'num_envs', {self.num_envs}, not {self.processes}"
            )
