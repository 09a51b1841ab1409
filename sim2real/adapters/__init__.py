"""Adapters: what differs between a simulation and a robot, each a wrapper around a backend."""
