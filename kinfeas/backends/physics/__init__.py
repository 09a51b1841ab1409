"""What physics engines share: the prepared robot, task checks, drives, obstacles and settings.

Imports no engine; `kinfeas.backends.pybullet` and `kinfeas.backends.mujoco` use it.
"""
