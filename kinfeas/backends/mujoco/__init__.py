"""The MuJoCo backend: robots, grippers, furniture and contacts, with physics.

The only package that imports mujoco.
"""
