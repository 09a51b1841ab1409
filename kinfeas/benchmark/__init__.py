"""Benchmarks of policies and of speed: jobs, tables, plots. May import all but the command line."""
