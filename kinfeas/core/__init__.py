"""Poses, twists, errors, the plugin registry and the protocols. Imports config and io alone."""
