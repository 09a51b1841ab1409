"""The PyBullet backend: robots, grippers, furniture, contacts and pictures, with physics.

The only package that imports pybullet.
"""
