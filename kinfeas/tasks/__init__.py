"""Tasks: random goals, and sequences of sub-goals in YAML.

May import control and lower packages.
"""
