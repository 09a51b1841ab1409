"""Simulated worlds as backends of the loop. May import tasks, policies and the control loop."""
