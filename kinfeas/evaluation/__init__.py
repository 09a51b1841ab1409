"""Evaluation: episodes, ceiling, speed, plots and reports."""
