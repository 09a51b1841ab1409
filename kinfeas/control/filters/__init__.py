"""Command filters: feasibility and obstacle distance."""
