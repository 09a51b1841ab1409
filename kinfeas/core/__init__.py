"""Poses and twists, errors, files, and the protocols of all plugins.

Every package may import it; it imports none of them.
"""
