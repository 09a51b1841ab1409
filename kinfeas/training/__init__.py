"""Training runs with Stable-Baselines3; the only package that imports torch."""
