"""Evaluation in the PyBullet world."""
