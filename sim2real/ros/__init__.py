"""Robots behind the topics of ROS 1 and ROS 2."""
