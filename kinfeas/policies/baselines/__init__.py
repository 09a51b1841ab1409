"""Base motions that are not learned: what a policy has to beat."""
