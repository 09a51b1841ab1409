"""Batched kinematics: chains, IK, self-collision, reachability. May import robots and below."""
