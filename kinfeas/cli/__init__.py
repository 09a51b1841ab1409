"""The command line: one module a command, and common options.

The only package that prints. May import every other one, within the functions of the commands.
"""
