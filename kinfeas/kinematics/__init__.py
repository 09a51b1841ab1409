"""Batched kinematics, compiled by numba: chains, IK, collisions, base drives.

May import robots and lower packages.
"""
