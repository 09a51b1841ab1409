"""Scenes: furniture in YAML and URDF, handles, and collisions of robots with them.

May import kinematics and lower packages.
"""
