"""Robots: a folder each, with model, URDF, recipes, ROS topics and trained policies.

May import core, config and io. Each folder with a `robot.yaml` is a robot of that name; its first
line is the title.
"""
