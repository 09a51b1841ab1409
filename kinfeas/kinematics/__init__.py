"""Batched kinematics: forward kinematics, Jacobian, self-collision, inverse kinematics, ceiling."""
