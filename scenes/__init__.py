"""Scenes: furniture in YAML and URDF, handles, and furniture as solids.

May import kinematics and lower packages.
"""
