"""Evaluation: episodes, metrics, pictures and speed."""
