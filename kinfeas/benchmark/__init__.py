"""The benchmark: a study, what has to be run for it, and the tables and plots that come of it."""
