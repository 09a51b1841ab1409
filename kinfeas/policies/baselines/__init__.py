"""Base policies without learning, for comparison; entry points of `kinfeas.policies`."""
