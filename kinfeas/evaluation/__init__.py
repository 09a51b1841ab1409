"""Evaluation of policies: episodes, reachability, adapters. May import envs and sim2real."""
