"""Backends for robots with ROS 1 or ROS 2 topics, on the link of `kinfeas.sim2real.link`."""
