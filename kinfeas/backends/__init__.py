"""Simulated worlds: the analytic backend and PyBullet.

They implement the protocols of `kinfeas.core.backend`. May import tasks, policies and lower packages.
"""
