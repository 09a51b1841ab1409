"""Benchmarks: result tables of policies (`benchmark`) and timings (`speed`).

May import everything but `cli` and `api`.
"""
