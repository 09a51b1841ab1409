"""Poses and twists, errors, the plugin registry, and the protocols of all plugins.

Every package may import it; it imports config and io alone.
"""
