"""Learned base motions that keep any end-effector motion kinematically feasible."""

__version__ = "0.1.0"
