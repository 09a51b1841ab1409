"""Built-in motion generators, and the fitting of demonstrations.

Entry points of `kinfeas.motion_generators`. May import core, config and io only.
"""
