"""Simulated robots behind the topics of real ones, for rehearsals of a deployment."""
