"""Evaluation of policies in any world: metrics and the ceiling."""
