"""Scenes: rooms, furniture and handles. May import kinematics and lower packages."""
