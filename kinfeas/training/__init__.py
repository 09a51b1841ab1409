"""Training runs with Stable-Baselines3: recipes, checkpoints, resuming.

May import envs and lower packages. The only package that imports torch.
"""
