"""Common parts of physics engines: the prepared robot, task checks, drives, obstacles, settings.

Imports no engine; `kinfeas.backends.pybullet` and `kinfeas.backends.mujoco` use it.
"""
