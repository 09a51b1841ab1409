"""Identification of a robot from its records: the pattern to drive, the model and its fit."""
