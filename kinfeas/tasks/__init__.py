"""Tasks: where episodes begin and where the EE has to go."""
