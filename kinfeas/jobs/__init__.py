"""Jobs, restartable calls with a JSON file each, and the engines that run them.

Imported by `benchmark` and what is above it; may import everything else.
"""
