"""Planning of whole motions in advance: base poses, and paths of EE, base and arm.

May import kinematics and lower packages.
"""
