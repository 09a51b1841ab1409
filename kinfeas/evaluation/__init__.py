"""Evaluation of policies in any world: metrics, reachability, cost of adapters.

May import envs and lower packages, but not training.
"""
