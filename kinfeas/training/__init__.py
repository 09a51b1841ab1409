"""Training with Stable-Baselines3: the only place that imports torch."""
