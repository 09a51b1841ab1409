"""Simulated worlds: the analytic backend, PyBullet and MuJoCo.

They implement `kinfeas.core.backend`. May import tasks, policies and lower packages.
"""
