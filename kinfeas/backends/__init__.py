"""Simulated worlds: the analytic backend and PyBullet.

They implement `kinfeas.core.backend`. May import tasks, policies and lower packages.
"""
