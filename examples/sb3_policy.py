"""Train with your own Stable-Baselines3 code; evaluate, export and use the policy."""

import argparse
from pathlib import Path

from stable_baselines3 import SAC

import kinfeas
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.learner import save_policy
from kinfeas.training.vec_env import WorldVecEnv


def main() -> None:
    """Train HSR with SAC, then evaluate and export its policy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("runs/sb3"))
    options = parser.parse_args()

    world = World(load_robot("hsr"), load_task("ggr"), WorldConfig(), seed=0)
    env = WorldVecEnv(world, num_envs=64)
    model = SAC(
        "MlpPolicy",
        env,
        policy_kwargs={"net_arch": [128, 128]},
        learning_starts=min(3000, options.steps),
        ent_coef=0.01,
        seed=0,
        device="cpu",
    )
    model.learn(options.steps, progress_bar=False)

    options.out.mkdir(parents=True, exist_ok=True)
    save_policy(model, env, options.out)
    env.close()
    summary = kinfeas.evaluate(options.out, robot="hsr", episodes=options.episodes)
    print(f"success {100 * summary['success']:.0f} % of {options.episodes} episodes")
    kinfeas.export(options.out, options.out / "policy.onnx", robot="hsr")
    print(f"kinfeas deploy {options.out / 'policy.onnx'} --backend analytic --goal 1.5 0.5 0.9")


if __name__ == "__main__":
    main()
