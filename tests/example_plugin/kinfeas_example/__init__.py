"""A motion generator and a task from outside."""
