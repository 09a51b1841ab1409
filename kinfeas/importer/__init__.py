"""Drafts of robot files from vendors' URDFs: `kinfeas robot import`.

May import control, kinematics and lower packages; trimesh is imported here only.
"""
