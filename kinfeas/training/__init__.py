"""Training of base policies: the only place that imports torch and Stable-Baselines3."""
