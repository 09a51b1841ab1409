"""Tasks: goal reaching and chains of sub-goals. May import control."""
