"""Step one environment and a vector of environments."""

import argparse

import gymnasium
import numpy as np

from kinfeas.control.observation import TERMS

ENVIRONMENT = "kinfeas.envs:kinfeas/BaseMotion-v0"  # module that registers it, and name


def main() -> None:
    """Run random actions in one environment and zero actions in 64."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--robot", default="tiago")
    options = parser.parse_args()

    env = gymnasium.make(ENVIRONMENT, robot=options.robot, task="ggr")
    print(f"observation {env.observation_space.shape}: {', '.join(TERMS)}")
    print(f"action {env.action_space.shape}: base velocities as fractions of their limits")
    env.reset(seed=0)
    env.action_space.seed(0)
    total = 0.0
    for _ in range(options.steps):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        total += reward
        if terminated or truncated:
            print(f"episode ended after {info['failures']} failures")
            env.reset()
    print(f"{options.steps} steps, reward {total:.1f}")
    env.close()

    many = gymnasium.make_vec(
        ENVIRONMENT,
        num_envs=64,
        vectorization_mode="vector_entry_point",
        robot=options.robot,
    )
    many.reset(seed=0)
    rewards = [many.step(np.zeros(many.action_space.shape))[1] for _ in range(options.steps // 10)]
    print(f"64 robots with zero actions: mean reward {np.mean(rewards):.3f} a step")
    many.close()


if __name__ == "__main__":
    main()
