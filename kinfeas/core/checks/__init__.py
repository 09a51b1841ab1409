"""Checks of what plugins return: shapes, finiteness, parameters."""
