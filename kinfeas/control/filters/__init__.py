"""Command filters; entry points `kinfeas.filters`.

A filter changes the base commands of a policy before they are sent. The loop applies a list of
them in order.
"""
