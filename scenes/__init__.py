"""Scenes: rooms, furniture and handles, and what loads them."""
