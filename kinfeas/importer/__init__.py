"""Drafts of robot files from vendors' URDFs, xacros and MJCFs: `kinfeas robot import`.

May import control, kinematics and lower packages; trimesh and xacro are imported here only.
"""
