"""Batched kinematics, compiled by numba: chains, IK, self-collision, reachability.

May import robots and lower packages.
"""
