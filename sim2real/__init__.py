"""From simulation to robot: adapters, export, deployment, links to robots, simulated robots.

May import envs and lower packages, but not training: a robot's computer has no torch.
"""
