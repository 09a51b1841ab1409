"""Adapters: wrappers of a backend that model noise, latency, limits and timing.

Entry points of the group `kinfeas.adapters`.
"""
