"""Plans of whole motions in advance: where to stand, and paths of EE, base and arm.

May import kinematics and lower packages.
"""
