"""Teleoperation: targets that come from people, models and trackers while a robot runs.

Sources have the entry points `kinfeas.target_sources`.
"""
