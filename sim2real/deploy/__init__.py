"""Policies on robots: runtime, guards, watchdog and preflight checks."""
