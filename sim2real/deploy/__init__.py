"""Deployment: the control loop with a clock, guards, a watchdog and a record."""
